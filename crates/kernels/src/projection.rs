//! ν₀ = −Sᵀ N ζ, the first product of every step of sparse fusion, in the cheaper of two forms.

use crate::linalg::{add_gemv_transposed, axpy, dot, gemv};
use crate::{Error, Result};

/// How to apply −Sᵀ N.
#[derive(Debug, Clone)]
pub struct Projection {
    kind: Kind,
    /// S⁺ per sensor, so that S S⁺ ζ has the same N ζ: gives q = ζᵀ N ζ = −(S⁺ ζ)ᵀ ν₀. Blocks (d_i, n c_i).
    inverse: Blocks,
}

#[derive(Debug, Clone)]
enum Kind {
    /// −Sᵀ N, (d, m n).
    Dense(Vec<f64>),
    /// N = diag(1/R) ⊗ I − (Z ⊗ I) K (Z ⊗ I)ᵀ with Z (m, r), K (r n, r n), then −Sᵀ per sensor.
    Structured { n: usize, precision: Vec<f64>, mix: Vec<f64>, core: Vec<f64>, basis_transposed: Blocks },
}

/// Block-diagonal matrix with one block per sensor.
#[derive(Debug, Clone)]
pub struct Blocks {
    /// First row and first column of every block, and the totals at the end.
    rows: Vec<usize>,
    columns: Vec<usize>,
    /// The blocks, row-major, one after the other.
    data: Vec<f64>,
}

impl Blocks {
    /// Check the sizes.
    ///
    /// # Errors
    /// If `data` does not hold what rows and columns promise.
    pub fn new(rows: Vec<usize>, columns: Vec<usize>, data: Vec<f64>) -> Result<Self> {
        Error::check_len("blocks", rows.len(), columns.len())?;
        let total = rows.windows(2).zip(columns.windows(2)).map(|(r, c)| (r[1] - r[0]) * (c[1] - c[0])).sum();
        Error::check_len("blocks", total, data.len())?;
        Ok(Self { rows, columns, data })
    }

    /// y = this · x
    fn apply(&self, x: &[f64], y: &mut [f64]) {
        let mut at = 0;
        for (r, c) in self.rows.windows(2).zip(self.columns.windows(2)) {
            let size = (r[1] - r[0]) * (c[1] - c[0]);
            gemv(&self.data[at..at + size], &x[c[0]..c[1]], &mut y[r[0]..r[1]]);
            at += size;
        }
    }

    fn rows(&self) -> usize {
        self.rows.last().copied().unwrap_or(0)
    }

    fn columns(&self) -> usize {
        self.columns.last().copied().unwrap_or(0)
    }
}

impl Projection {
    /// From the dense matrix −Sᵀ N (d, m n).
    ///
    /// # Errors
    /// If the sizes do not fit.
    pub fn dense(matrix: Vec<f64>, inverse: Blocks) -> Result<Self> {
        Error::check_len("projection", inverse.rows() * inverse.columns(), matrix.len())?;
        Ok(Self { kind: Kind::Dense(matrix), inverse })
    }

    /// From the factors of N: 1/R (m,), Z (m, r), K (r n, r n) and the blocks Sᵀ.
    ///
    /// # Errors
    /// If the sizes do not fit.
    pub fn structured(
        n: usize,
        precision: Vec<f64>,
        mix: Vec<f64>,
        core: Vec<f64>,
        basis_transposed: Blocks,
        inverse: Blocks,
    ) -> Result<Self> {
        let m = precision.len();
        let r = mix.len().checked_div(m).unwrap_or(0);
        Error::check_len("mix", m * r, mix.len())?;
        Error::check_len("core", r * n * r * n, core.len())?;
        Error::check_len("basis", m * n, basis_transposed.columns())?;
        Ok(Self { kind: Kind::Structured { n, precision, mix, core, basis_transposed }, inverse })
    }

    /// Scratch space that [`Projection::apply`] and [`Projection::energy`] need.
    #[must_use]
    pub fn scratch(&self) -> Vec<f64> {
        let own = match &self.kind {
            Kind::Dense(_) => 0,
            Kind::Structured { n, precision, mix, .. } => {
                let (m, r) = (precision.len(), mix.len() / precision.len());
                2 * r * n + m * n
            }
        };
        vec![0.0; own.max(self.inverse.rows())]
    }

    /// ν₀ = −Sᵀ N ζ.
    pub fn apply(&self, zeta: &[f64], nu: &mut [f64], scratch: &mut [f64]) {
        match &self.kind {
            Kind::Dense(matrix) => gemv(matrix, zeta, nu),
            Kind::Structured { n, precision, mix, core, basis_transposed } => {
                let (n, m) = (*n, precision.len());
                let r = mix.len() / m;
                let (mixed, rest) = scratch.split_at_mut(r * n);
                let (image, rest) = rest.split_at_mut(r * n);
                let full = &mut rest[..m * n];
                mixed.fill(0.0);
                for (weights, local) in mix.chunks_exact(r).zip(zeta.chunks_exact(n)) {
                    for (&weight, target) in weights.iter().zip(mixed.chunks_exact_mut(n)) {
                        axpy(weight, local, target);
                    }
                }
                gemv(core, mixed, image);
                for i in 0..m {
                    let target = &mut full[i * n..(i + 1) * n];
                    for (value, local) in target.iter_mut().zip(&zeta[i * n..(i + 1) * n]) {
                        *value = -precision[i] * local;
                    }
                    add_gemv_transposed(image, &mix[i * r..(i + 1) * r], target);
                }
                basis_transposed.apply(full, nu);
            }
        }
    }

    /// q = ζᵀ N ζ, given ν₀.
    #[must_use]
    pub fn energy(&self, zeta: &[f64], nu: &[f64], scratch: &mut [f64]) -> f64 {
        let part = &mut scratch[..self.inverse.rows()];
        self.inverse.apply(zeta, part);
        -dot(part, nu)
    }
}
