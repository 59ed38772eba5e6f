//! A small dense matrix whose products go into matrices that exist already: no step allocates.

use std::ops::{Index, IndexMut};

use crate::linalg::{axpy, dot};

/// A matrix, row-major.
#[derive(Debug, PartialEq)]
pub struct Matrix {
    rows: usize,
    columns: usize,
    data: Vec<f64>,
}

impl Clone for Matrix {
    /// A copy with the same room: whoever works in it need not allocate either.
    fn clone(&self) -> Self {
        let mut data = Vec::with_capacity(self.data.capacity());
        data.extend_from_slice(&self.data);
        Self { rows: self.rows, columns: self.columns, data }
    }
}

impl Index<(usize, usize)> for Matrix {
    type Output = f64;

    fn index(&self, (i, j): (usize, usize)) -> &f64 {
        &self.data[i * self.columns + j]
    }
}

impl IndexMut<(usize, usize)> for Matrix {
    fn index_mut(&mut self, (i, j): (usize, usize)) -> &mut f64 {
        &mut self.data[i * self.columns + j]
    }
}

impl Matrix {
    /// Zeros.
    #[must_use]
    pub fn zeros(rows: usize, columns: usize) -> Self {
        Self { rows, columns, data: vec![0.0; rows * columns] }
    }

    /// Room for as many numbers; empty until a product gives it a shape.
    #[must_use]
    pub fn room(numbers: usize) -> Self {
        Self { rows: 0, columns: 0, data: Vec::with_capacity(numbers) }
    }

    /// From numbers by rows.
    #[must_use]
    pub fn from_rows(rows: usize, columns: usize, numbers: &[f64]) -> Self {
        let mut matrix = Self::zeros(rows, columns);
        matrix.data.copy_from_slice(numbers);
        matrix
    }

    /// Zeros but for `p` (n, n) in the upper left corner.
    #[must_use]
    pub fn corner(rows: usize, columns: usize, n: usize, p: &[f64]) -> Self {
        let mut matrix = Self::zeros(rows, columns);
        (0..n).for_each(|a| matrix.row_mut(a)[..n].copy_from_slice(&p[a * n..(a + 1) * n]));
        matrix
    }

    /// Number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// All numbers, by rows.
    #[must_use]
    pub fn numbers(&self) -> &[f64] {
        &self.data
    }

    /// All numbers, by rows, to be changed.
    pub fn numbers_mut(&mut self) -> &mut [f64] {
        &mut self.data
    }

    /// Row i.
    #[must_use]
    pub fn row(&self, i: usize) -> &[f64] {
        &self.data[i * self.columns..(i + 1) * self.columns]
    }

    /// Row i, to be changed.
    pub fn row_mut(&mut self, i: usize) -> &mut [f64] {
        &mut self.data[i * self.columns..(i + 1) * self.columns]
    }

    /// Two different rows, the first to be changed.
    fn row_and(&mut self, target: usize, source: usize) -> (&mut [f64], &[f64]) {
        let width = self.columns;
        if target < source {
            let (head, tail) = self.data.split_at_mut(source * width);
            return (&mut head[target * width..(target + 1) * width], &tail[..width]);
        }
        let (head, tail) = self.data.split_at_mut(target * width);
        (&mut tail[..width], &head[source * width..(source + 1) * width])
    }

    /// Row `target` += factor · row `source`.
    pub fn add_row(&mut self, factor: f64, source: usize, target: usize) {
        let (target, source) = self.row_and(target, source);
        axpy(factor, source, target);
    }

    /// Become zeros of another shape.
    pub fn shape(&mut self, rows: usize, columns: usize) {
        (self.rows, self.columns) = (rows, columns);
        self.data.clear();
        self.data.resize(rows * columns, 0.0);
    }

    /// Become zero without a change of shape.
    pub fn set_zero(&mut self) {
        self.data.fill(0.0);
    }

    /// Become the identity.
    pub fn set_identity(&mut self, size: usize) {
        self.shape(size, size);
        (0..size).for_each(|i| self[(i, i)] = 1.0);
    }

    /// Become a copy.
    pub fn copy_from(&mut self, other: &Self) {
        (self.rows, self.columns) = (other.rows, other.columns);
        self.data.clear();
        self.data.extend_from_slice(&other.data);
    }

    /// Become Aᵀ.
    pub fn set_transpose(&mut self, a: &Self) {
        self.shape(a.columns, a.rows);
        for i in 0..a.rows {
            for (j, &value) in a.row(i).iter().enumerate() {
                self[(j, i)] = value;
            }
        }
    }

    /// Become A B.
    pub fn set_product(&mut self, a: &Self, b: &Self) {
        self.shape(a.rows, b.columns);
        self.add_product(1.0, a, b);
    }

    /// += factor · A B
    pub fn add_product(&mut self, factor: f64, a: &Self, b: &Self) {
        for i in 0..a.rows {
            let target = &mut self.data[i * b.columns..(i + 1) * b.columns];
            for (&value, row) in a.row(i).iter().zip(b.data.chunks_exact(b.columns.max(1))) {
                if value != 0.0 {
                    axpy(factor * value, row, target);
                }
            }
        }
    }

    /// Become A Bᵀ.
    pub fn set_product_transposed(&mut self, a: &Self, b: &Self) {
        self.shape(a.rows, b.rows);
        self.add_product_transposed(1.0, a, b);
    }

    /// += factor · A Bᵀ
    pub fn add_product_transposed(&mut self, factor: f64, a: &Self, b: &Self) {
        for i in 0..a.rows {
            for j in 0..b.rows {
                self[(i, j)] += factor * dot(a.row(i), b.row(j));
            }
        }
    }

    /// += factor · A
    pub fn add(&mut self, factor: f64, a: &Self) {
        axpy(factor, &a.data, &mut self.data);
    }

    /// += factor · Aᵀ
    pub fn add_transpose(&mut self, factor: f64, a: &Self) {
        for i in 0..self.rows {
            for j in 0..self.columns {
                self[(i, j)] += factor * a[(j, i)];
            }
        }
    }

    /// The mean of itself and its transpose.
    pub fn symmetrise(&mut self) {
        for i in 0..self.rows {
            for j in 0..i {
                let mean = 0.5 * (self[(i, j)] + self[(j, i)]);
                self[(i, j)] = mean;
                self[(j, i)] = mean;
            }
        }
    }

    /// Whether every number is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.data.iter().all(|value| value.is_finite())
    }
}
