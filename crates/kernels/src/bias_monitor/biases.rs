//! The biases that were named: their sizes by least squares since their onsets, all together.
//!
//! ```text
//!     ε = Σ_b s_b b + white,   G = Σ_t sᵀ s,   h = Σ_t sᵀ ε,   b̂ = G⁻¹ h,   V = γ G⁻¹
//! ```
//!
//! The end of a bias is a second step on the same channel; what the channel adds is the sum of its steps. Two steps
//! whose difference the filter has forgotten become one, or none if their sum is nothing.

use crate::bias_monitor::effect::Steady;
use crate::bias_monitor::scan::Scan;
use crate::codec::{Decoder, Encoder};
use crate::linalg::{axpy, cholesky, cholesky_solve, dot};
use crate::{Error, Result};

/// Steps that can be known at a time.
pub const CAPACITY: usize = 4;
/// Largest whitened difference of two steps on a channel that counts as forgotten.
const FORGOTTEN: f64 = 0.1;
/// A step whose share of new information is smaller than this repeats another one.
const REPEATED: f64 = 1e-10;

/// Steps in the order in which they were named.
#[derive(Debug, Clone)]
pub struct Biases {
    n: usize,
    m: usize,
    table: usize,
    count: usize,
    channel: [usize; CAPACITY],
    /// Samples since the onset, the present one included.
    age: [usize; CAPACITY],
    /// z: effect of the unit on x[k|k−1], (CAPACITY, n).
    prior: Vec<f64>,
    /// w: the same on x[k|k].
    posterior: Vec<f64>,
    /// s: effect on ε, (CAPACITY, m).
    signature: Vec<f64>,
    /// Sums of [`Scan`] with s in place of ε, (CAPACITY, window, width).
    sums: Vec<f64>,
    gram: Square,
    moment: [f64; CAPACITY],
    size: [f64; CAPACITY],
    covariance: Square,
}

type Square = [[f64; CAPACITY]; CAPACITY];

/// Factor of the first `count` rows and columns; else the first row whose pivot is below `least` of its diagonal.
fn factor(
    matrix: &Square,
    count: usize,
    least: f64,
) -> std::result::Result<[f64; CAPACITY * CAPACITY], usize> {
    let mut flat = [0.0; CAPACITY * CAPACITY];
    for (target, row) in flat.chunks_exact_mut(CAPACITY).zip(matrix) {
        target.copy_from_slice(row);
    }
    cholesky(&mut flat, count, CAPACITY, least).map(|()| flat)
}

fn inverse(factor: &[f64], count: usize, scale: f64) -> Square {
    let mut inverse = [[0.0; CAPACITY]; CAPACITY];
    for (i, row) in inverse.iter_mut().enumerate().take(count) {
        row[i] = scale;
        cholesky_solve(factor, CAPACITY, &mut row[..count]);
    }
    inverse
}

impl Biases {
    /// Room for the steps of a filter of `scan`.
    #[must_use]
    pub fn new(steady: &Steady, scan: &Scan) -> Self {
        let (n, m, table) = (steady.model.dims.states, steady.model.dims.channels, scan.size());
        Self {
            n,
            m,
            table,
            count: 0,
            channel: [0; CAPACITY],
            age: [0; CAPACITY],
            prior: vec![0.0; CAPACITY * n],
            posterior: vec![0.0; CAPACITY * n],
            signature: vec![0.0; CAPACITY * m],
            sums: vec![0.0; CAPACITY * table],
            gram: [[0.0; CAPACITY]; CAPACITY],
            moment: [0.0; CAPACITY],
            size: [0.0; CAPACITY],
            covariance: [[0.0; CAPACITY]; CAPACITY],
        }
    }

    /// How many steps there are.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// Channels of the steps.
    #[must_use]
    pub fn channels(&self) -> &[usize] {
        &self.channel[..self.count]
    }

    /// Sizes of the steps, and their sums for [`Scan::score`].
    #[must_use]
    pub fn known(&self) -> (&[f64], &[f64]) {
        (&self.size[..self.count], &self.sums[..self.count * self.table])
    }

    /// What a channel adds, and its variance; None if no step is on it.
    #[must_use]
    pub fn total(&self, channel: usize) -> Option<(f64, f64)> {
        let own = || (0..self.count).filter(move |&e| self.channel[e] == channel);
        own().next()?;
        let variance = own().flat_map(|e| own().map(move |f| self.covariance[e][f])).sum();
        Some((own().map(|e| self.size[e]).sum(), variance))
    }

    /// `out` += C Σ z b: from the innovation of the plain filter to that of the estimate without the biases.
    pub fn add_to_innovation(&self, steady: &Steady, out: &mut [f64]) {
        for (z, size) in self.prior.chunks_exact(self.n).zip(&self.size).take(self.count) {
            for (column, value) in steady.model.c_t(0).chunks_exact(self.m).zip(z) {
                axpy(size * value, column, out);
            }
        }
    }

    /// Take in the sample's whitened innovations ε: `fill` treats a response as missing innovations were.
    pub fn observe(&mut self, steady: &Steady, scan: &Scan, news: &[f64], mut fill: impl FnMut(&mut [f64])) {
        for e in 0..self.count {
            let z = &self.prior[e * self.n..(e + 1) * self.n];
            let w = &mut self.posterior[e * self.n..(e + 1) * self.n];
            let s = &mut self.signature[e * self.m..(e + 1) * self.m];
            steady.respond(self.channel[e], z, s);
            fill(s);
            w.copy_from_slice(z);
            steady.correct(s, w);
            steady.whiten(s);
            scan.advance(s, &mut self.sums[e * self.table..(e + 1) * self.table]);
            self.age[e] += 1;
            for f in 0..=e {
                let product = dot(self.signature_of(e), self.signature_of(f));
                self.gram[e][f] += product;
                self.gram[f][e] = self.gram[e][f];
            }
            self.moment[e] += dot(self.signature_of(e), news);
        }
    }

    fn signature_of(&self, e: usize) -> &[f64] {
        &self.signature[e * self.m..(e + 1) * self.m]
    }

    /// Add the step on `channel` that began `age` samples before the present one, of which `sums` hold the evidence.
    /// Samples that were missing since then count as if they had come.
    pub fn add(&mut self, steady: &Steady, scan: &Scan, (channel, age): (usize, usize), sums: &[f64]) {
        let (e, n, m) = (self.count, self.n, self.m);
        self.count += 1;
        (self.channel[e], self.age[e]) = (channel, age + 1);
        for f in 0..e {
            self.gram[e][f] = scan.sum(&self.sums[f * self.table..], channel, age);
            self.gram[f][e] = self.gram[e][f];
        }
        self.gram[e][e] = scan.energy(channel, age);
        self.moment[e] = scan.sum(sums, channel, age);
        let z = &mut self.prior[e * n..(e + 1) * n];
        let w = &mut self.posterior[e * n..(e + 1) * n];
        let s = &mut self.signature[e * m..(e + 1) * m];
        let own = &mut self.sums[e * self.table..(e + 1) * self.table];
        z.fill(0.0);
        own.fill(0.0);
        for past in 0..=age {
            if past > 0 {
                steady.carry(w, z);
            }
            steady.respond(channel, z, s);
            w.copy_from_slice(z);
            steady.correct(s, w);
            steady.whiten(s);
            scan.advance(s, own);
        }
    }

    /// b̂ and V; steps with b̂² < `drop` V leave, the weakest first.
    pub fn solve(&mut self, gamma: f64, drop: f64) {
        while self.count > 0 {
            let factor = match factor(&self.gram, self.count, REPEATED) {
                Ok(factor) => factor,
                Err(repeated) => {
                    self.remove(repeated);
                    continue;
                }
            };
            self.covariance = inverse(&factor, self.count, gamma);
            self.size = self.moment;
            cholesky_solve(&factor, CAPACITY, &mut self.size[..self.count]);
            let strength = |e: usize| self.size[e] * self.size[e] / self.covariance[e][e];
            let weakest = (0..self.count).min_by(|&e, &f| strength(e).total_cmp(&strength(f)));
            match weakest {
                Some(e) if strength(e) < drop => self.remove(e),
                _ => return,
            }
        }
    }

    /// Forget the first pair of steps on one channel whose difference is forgotten: one step is left, or none if their
    /// sum is not significant. What is known of the others stays.
    pub fn settle(&mut self, gamma: f64, drop: f64, window: usize) {
        let pairs = (0..self.count).flat_map(|f| (0..f).map(move |e| (e, f)));
        let Some((e, f)) = pairs.into_iter().find(|&(e, f)| self.is_settled(e, f, window)) else { return };
        let total = self.size[e] + self.size[f];
        let v = &self.covariance;
        let variance = v[e][e] + 2.0 * v[e][f] + v[f][f];
        let keep = total * total >= drop * variance;
        if keep {
            self.merge(e, f);
        }
        // The others keep estimate and covariance, whatever is known of what leaves.
        let leaving: &[usize] = if keep { &[f] } else { &[f, e] };
        leaving.iter().for_each(|&gone| self.remove(gone));
        let Ok(factor) = factor(&self.covariance, self.count, 0.0) else { return };
        self.gram = inverse(&factor, self.count, gamma);
        for i in 0..self.count {
            self.moment[i] = dot(&self.gram[i][..self.count], &self.size[..self.count]);
        }
    }

    fn is_settled(&self, e: usize, f: usize, window: usize) -> bool {
        let smaller = self.size[e].abs().min(self.size[f].abs());
        let apart = || {
            let difference = self.signature_of(e).iter().zip(self.signature_of(f)).map(|(a, b)| a - b);
            difference.map(|value| value * value).sum::<f64>().sqrt()
        };
        self.channel[e] == self.channel[f]
            && self.age[e].min(self.age[f]) > window
            && smaller * apart() < FORGOTTEN
    }

    /// Step e becomes the sum of e and f: b_e s_e + b_f s_f = (b_e + b_f) s, and so are all other effects.
    fn merge(&mut self, e: usize, f: usize) {
        let total = self.size[e] + self.size[f];
        let (share, other) = (self.size[e] / total, self.size[f] / total);
        for (numbers, width) in [
            (&mut self.prior, self.n),
            (&mut self.posterior, self.n),
            (&mut self.signature, self.m),
            (&mut self.sums, self.table),
        ] {
            for i in 0..width {
                numbers[e * width + i] = share * numbers[e * width + i] + other * numbers[f * width + i];
            }
        }
        self.size[e] = total;
        let added = self.covariance[f];
        self.covariance[e].iter_mut().zip(added).for_each(|(target, value)| *target += value);
        for row in self.covariance.iter_mut().take(self.count) {
            row[e] += row[f];
        }
    }

    fn remove(&mut self, gone: usize) {
        let (from, to) = (gone + 1, self.count);
        self.channel.copy_within(from..to, gone);
        self.age.copy_within(from..to, gone);
        self.moment.copy_within(from..to, gone);
        self.size.copy_within(from..to, gone);
        for matrix in [&mut self.gram, &mut self.covariance] {
            matrix.copy_within(from..to, gone);
            matrix.iter_mut().for_each(|row| row.copy_within(from..to, gone));
        }
        for (numbers, width) in [
            (&mut self.prior, self.n),
            (&mut self.posterior, self.n),
            (&mut self.signature, self.m),
            (&mut self.sums, self.table),
        ] {
            numbers.copy_within(from * width..to * width, gone * width);
        }
        self.count -= 1;
    }

    /// x −= Σ w b.
    pub fn subtract_from(&self, x: &mut [f64]) {
        for (w, size) in self.posterior.chunks_exact(self.n).zip(&self.size).take(self.count) {
            axpy(-size, w, x);
        }
    }

    /// Element (i, j) of Σ_ef w_e V_ef w_fᵀ: what is not known of the biases, in x.
    #[must_use]
    pub fn spread(&self, i: usize, j: usize) -> f64 {
        let w = |e: usize, i: usize| self.posterior[e * self.n + i];
        let pairs = (0..self.count).flat_map(|e| (0..self.count).map(move |f| (e, f)));
        pairs.map(|(e, f)| w(e, i) * self.covariance[e][f] * w(f, j)).sum()
    }

    /// z ← A w.
    pub fn predict(&mut self, steady: &Steady) {
        let effects = self.posterior.chunks_exact(self.n).zip(self.prior.chunks_exact_mut(self.n));
        effects.take(self.count).for_each(|(w, z)| steady.carry(w, z));
    }

    /// Between two samples: everything that the next one needs.
    pub fn save(&self, to: &mut Encoder) {
        let count = self.count;
        to.integer(count as u64);
        for e in 0..count {
            to.integer(self.channel[e] as u64);
            to.integer(self.age[e] as u64);
            to.floats(&self.gram[e][..count]);
        }
        to.floats(&self.moment[..count]);
        to.floats(&self.size[..count]);
        to.floats(&self.prior[..count * self.n]);
        to.floats(&self.sums[..count * self.table]);
    }

    /// # Errors
    /// [`Error::Resume`] if the bytes do not fit.
    pub fn load(&mut self, from: &mut Decoder<'_>) -> Result<()> {
        let wrong = || Error::Resume("the saved filter state holds biases that cannot be".into());
        let count = from.integer()? as usize;
        if count > CAPACITY {
            return Err(wrong());
        }
        self.count = count;
        for e in 0..count {
            self.channel[e] = from.integer()? as usize;
            self.age[e] = from.integer()? as usize;
            from.floats(&mut self.gram[e][..count])?;
            if self.channel[e] >= self.m {
                return Err(wrong());
            }
        }
        from.floats(&mut self.moment[..count])?;
        from.floats(&mut self.size[..count])?;
        from.floats(&mut self.prior[..count * self.n])?;
        from.floats(&mut self.sums[..count * self.table])
    }
}
