//! Everything about a step that does not depend on the data.

use crate::joint_fusion::layout::Layout;
use crate::matrix::Matrix;

/// Gains of every local, weights of the fusion, and how sure the results are.
#[derive(Debug, Clone)]
pub struct Gains {
    /// J_i = [K_i; −Γ_i], (n + 2p_i, m_i): s_i = z_i − J_i ỹ_i.
    pub j: Vec<Matrix>,
    /// [G_1 … G_r], (n, n r).
    pub weights: Matrix,
    /// J_iᵀ and [G_1 … G_r]ᵀ, for products along contiguous memory.
    pub columns: (Vec<Matrix>, Matrix),
    /// P_0, covariance of the fused estimate, (n, n).
    pub covariance: Matrix,
    /// Its deviations, (n,).
    pub x_std: Vec<f64>,
    /// Standard deviation of θ − θ̂ of every injection, (Σ p_i,).
    pub attack_std: Vec<f64>,
    /// Standard deviation of y − C x[k|k−1] − D u of every channel, (m,).
    pub innovation_std: Vec<f64>,
    /// A covariance is none any more.
    pub broken: bool,
}

impl Gains {
    /// Room for one step.
    #[must_use]
    pub fn new(layout: &Layout, channels: usize) -> Self {
        let n = layout.n;
        Self {
            j: layout.locals.iter().map(|l| Matrix::zeros(l.size(n), l.height())).collect(),
            weights: Matrix::zeros(n, n * layout.count()),
            columns: (
                layout.locals.iter().map(|l| Matrix::zeros(l.height(), l.size(n))).collect(),
                Matrix::zeros(n * layout.count(), n),
            ),
            covariance: Matrix::zeros(n, n),
            x_std: vec![0.0; n],
            attack_std: vec![0.0; layout.weak],
            innovation_std: vec![0.0; channels],
            broken: false,
        }
    }

    /// Note the transposes of gains and weights.
    pub fn lay_out(&mut self) {
        let (columns, weights) = &mut self.columns;
        columns.iter_mut().zip(&self.j).for_each(|(columns, j)| columns.set_transpose(j));
        weights.set_transpose(&self.weights);
    }

    /// Bytes that one step takes.
    #[must_use]
    pub fn size(&self) -> usize {
        let matrices = self.j.iter().chain(&self.j).chain([&self.weights, &self.weights, &self.covariance]);
        let vectors = self.x_std.len() + self.attack_std.len() + self.innovation_std.len();
        size_of::<f64>() * (matrices.map(|matrix| matrix.numbers().len()).sum::<usize>() + vectors)
    }
}
