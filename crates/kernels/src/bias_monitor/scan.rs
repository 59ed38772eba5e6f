//! The generalised likelihood ratio of a constant bias on every channel, over every onset in a window.
//!
//! ```text
//!     s_{i,j} = L⁻¹ (e_i − C Z_j),   Z_0 = 0,   Z_{j+1} = F Z_j + A K e_i,   F = A (I − K C),   S = L Lᵀ
//!     c_{i,k}(t) = Σ_{j<k} s_{i,j}ᵀ ε_{t−k+1+j},   λ_{i,k} = Σ_{j<k} s_{i,j}ᵀ s_{i,j}
//!     g_i(t) = max_k  c_{i,k}² / (γ λ_{i,k}) − 2 κ ln(window / k)
//! ```
//!
//! ε are the whitened innovations. All sums of one kind lie in a table of (window, width): row k − 1 belongs to the
//! onset k samples ago, the present one included; `width` is m, rounded up so that rows fall into vectors of four.

use crate::dense::{Arithmetic, Work};
use crate::linalg::dot;

/// Numbers that one vector register of AVX2 holds.
const LANES: usize = 4;

/// What decides the penalised ratio.
#[derive(Debug, Clone, Copy)]
pub struct Rule {
    /// Onsets that compete.
    pub window: usize,
    /// Weight of the penalty on young onsets.
    pub kappa: f64,
    /// Variance of the whitened innovations over that of the model.
    pub gamma: f64,
}

/// The tables that no data change.
#[derive(Debug, Clone)]
pub struct Scan {
    arithmetic: Arithmetic,
    width: usize,
    /// s_{i,j}: per age j a matrix (m, width), row a the element a of all channels' signatures.
    signatures: Vec<f64>,
    /// λ_{i,k}, (window, width).
    energy: Vec<f64>,
    /// 1 / (γ λ_{i,k}), zero in the padding.
    weight: Vec<f64>,
    /// 2 κ ln(window / k), (window,).
    penalty: Vec<f64>,
}

/// Penalised ratio of every channel, and the onset that attains it.
#[derive(Debug, Clone)]
pub struct Scores {
    /// g_i, (width,).
    pub score: Vec<f64>,
    /// k − 1, (width,).
    pub age: Vec<f64>,
}

impl Scan {
    /// Room for the signatures of `channels` channels.
    #[must_use]
    pub fn new(rule: Rule, channels: usize) -> Self {
        let (Rule { window, kappa, .. }, width) = (rule, channels.next_multiple_of(LANES));
        Self {
            arithmetic: Arithmetic::default(),
            width,
            signatures: vec![0.0; window * channels * width],
            energy: vec![0.0; window * width],
            weight: vec![0.0; window * width],
            penalty: (1..=window).map(|k| 2.0 * kappa * (window as f64 / k as f64).ln()).collect(),
        }
    }

    /// Lay down s_{i,j}; ages must come in order.
    pub fn put(&mut self, rule: Rule, channel: usize, age: usize, signature: &[f64]) {
        let (m, width) = (signature.len(), self.width);
        for (a, value) in signature.iter().enumerate() {
            self.signatures[(age * m + a) * width + channel] = *value;
        }
        let at = age * width + channel;
        let before = if age == 0 { 0.0 } else { self.energy[at - width] };
        self.energy[at] = before + dot(signature, signature);
        self.weight[at] = 1.0 / (rule.gamma * self.energy[at]);
    }

    /// Numbers in a table of sums.
    #[must_use]
    pub fn size(&self) -> usize {
        self.weight.len()
    }

    /// λ of a channel for the onset `age` samples before the present one.
    #[must_use]
    pub fn energy(&self, channel: usize, age: usize) -> f64 {
        self.energy[age * self.width + channel]
    }

    /// The sum of a channel for the onset `age` samples before the present one.
    #[must_use]
    pub fn sum(&self, sums: &[f64], channel: usize, age: usize) -> f64 {
        sums[age * self.width + channel]
    }

    /// c_{i,k} ← c_{i,k−1} + s_{i,k−1}ᵀ ε.
    pub fn advance(&self, news: &[f64], sums: &mut [f64]) {
        let signatures = &self.signatures;
        self.arithmetic.run(Advance { signatures, news, width: self.width, sums });
    }

    /// Room for the scores.
    #[must_use]
    pub fn scores(&self) -> Scores {
        Scores { score: vec![0.0; self.width], age: vec![0.0; self.width] }
    }

    /// g_i over the onsets since the first of `samples` samples, of sums without what known biases put there:
    /// `known` holds their sizes, and their tables one after the other.
    pub fn score(&self, sums: &[f64], samples: usize, known: (&[f64], &[f64]), out: &mut Scores) {
        out.score.fill(f64::NEG_INFINITY);
        out.age.fill(0.0);
        self.arithmetic.run(Score { scan: self, sums, samples, known, out });
    }
}

struct Advance<'a> {
    signatures: &'a [f64],
    news: &'a [f64],
    width: usize,
    sums: &'a mut [f64],
}

impl Work for Advance<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { signatures, news, width, sums } = self;
        let kept = sums.len() - width;
        sums.copy_within(..kept, width);
        sums[..width].fill(0.0);
        for (signature, sums) in signatures.chunks_exact(news.len() * width).zip(sums.chunks_exact_mut(width))
        {
            add_rows(signature, news, sums);
        }
    }
}

/// `out` += Σ_a v_a row_a, four rows per pass over `out`, whose length is a multiple of four.
#[inline(always)]
fn add_rows(rows: &[f64], v: &[f64], out: &mut [f64]) {
    let width = out.len();
    let (out, _) = out.as_chunks_mut::<LANES>();
    let (fours, rest) = v.as_chunks::<4>();
    let (four_rows, rows) = rows.split_at(fours.len() * 4 * width);
    for (block, [v0, v1, v2, v3]) in four_rows.chunks_exact(4 * width).zip(fours) {
        let (r0, block) = block.split_at(width);
        let (r1, block) = block.split_at(width);
        let (r2, r3) = block.split_at(width);
        let (r0, r1, r2, r3) = (r0.as_chunks().0, r1.as_chunks().0, r2.as_chunks().0, r3.as_chunks().0);
        for ((((out, r0), r1), r2), r3) in out.iter_mut().zip(r0).zip(r1).zip(r2).zip(r3) {
            let (r0, r1, r2, r3): (&[f64; LANES], &[f64; LANES], &[f64; LANES], &[f64; LANES]) =
                (r0, r1, r2, r3);
            for lane in 0..LANES {
                out[lane] += (v0 * r0[lane] + v1 * r1[lane]) + (v2 * r2[lane] + v3 * r3[lane]);
            }
        }
    }
    for (row, value) in rows.chunks_exact(width).zip(rest) {
        for (out, row) in out.iter_mut().zip(row.as_chunks::<LANES>().0) {
            for lane in 0..LANES {
                out[lane] += value * row[lane];
            }
        }
    }
}

struct Score<'a> {
    scan: &'a Scan,
    sums: &'a [f64],
    samples: usize,
    known: (&'a [f64], &'a [f64]),
    out: &'a mut Scores,
}

impl Work for Score<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { scan, sums, samples, known: (sizes, tables), out } = self;
        let (width, table) = (scan.width, scan.size());
        let best = out.score.as_chunks_mut::<LANES>().0.iter_mut().zip(out.age.as_chunks_mut::<LANES>().0);
        for (block, (score, oldest)) in best.enumerate() {
            for (age, penalty) in scan.penalty.iter().enumerate().take(samples) {
                let at = age * width + block * LANES;
                let (Some(row), Some(weight)) = (four(sums, at), four(&scan.weight, at)) else { break };
                let mut row = *row;
                for (size, known) in sizes.iter().zip(tables.chunks_exact(table)) {
                    let Some(known) = four(known, at) else { break };
                    for lane in 0..LANES {
                        row[lane] -= size * known[lane];
                    }
                }
                for lane in 0..LANES {
                    let value = row[lane] * row[lane] * weight[lane] - penalty;
                    let better = value > score[lane];
                    score[lane] = if better { value } else { score[lane] };
                    oldest[lane] = if better { age as f64 } else { oldest[lane] };
                }
            }
        }
    }
}

/// Four numbers in a row.
#[inline(always)]
fn four(numbers: &[f64], at: usize) -> Option<&[f64; LANES]> {
    numbers.get(at..).and_then(|rest| rest.first_chunk())
}
