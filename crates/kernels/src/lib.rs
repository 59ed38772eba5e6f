//! The numerical kernels of securestate.
