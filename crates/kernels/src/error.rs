//! Everything that can go wrong at this boundary. Hard numerical cases are a [`crate::Status`], not an error.

use thiserror::Error;

/// A mistake of the caller: which argument, what was expected, what came.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum Error {
    /// An argument has the wrong shape or a value that cannot be used.
    #[error("{argument}: expected {expected}, received {received}")]
    Input {
        /// Name of the argument.
        argument: &'static str,
        /// What it should have been.
        expected: String,
        /// What it was.
        received: String,
    },
    /// A saved filter state that does not belong to this estimator, or is damaged.
    #[error("{0}")]
    Resume(String),
}

impl Error {
    /// Shorthand for [`Error::Input`].
    pub fn input(argument: &'static str, expected: impl Into<String>, received: impl Into<String>) -> Self {
        Self::Input { argument, expected: expected.into(), received: received.into() }
    }

    /// `Ok` if `received` equals `expected`, otherwise an error about the length of `argument`.
    pub fn check_len(argument: &'static str, expected: usize, received: usize) -> Result<()> {
        if expected == received {
            return Ok(());
        }
        Err(Self::input(argument, format!("{expected} numbers"), format!("{received}")))
    }
}

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;
