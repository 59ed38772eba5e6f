//! Expectation maximisation for a mixture of two Gaussians, the first of which has a known covariance per point.
//!
//! ```text
//!     p(x_i) = π₁ N(x_i; μ₁, P_i) + π₂ N(x_i; μ₂, Σ₂)                                  (13)
//!     γ_i = π₁ N(x_i; μ₁, P_i) / p(x_i)                                                (15), (16)
//!     π₁ = mean of γ_i,  μ₂, Σ₂ = mean and covariance of the points, weighted with 1 − γ_i    (17)–(19)
//!     μ₁ = Σ γ_i x_i / Σ γ_i, or (Σ γ_i P_i⁻¹)⁻¹ Σ γ_i P_i⁻¹ x_i                       (18)
//! ```
//!
//! # References
//! Zhu et al. 2022, equations (13)–(19). Not in the paper: the starting values, the rule to stop, and what keeps Σ₂
//! away from zero, where the likelihood has no bound.

use crate::kalman::whitening::LogProduct;
use crate::linalg::{axpy, cholesky, cholesky_solve, dot, forward_solve};
use crate::mixture_fusion::known::Known;
use crate::mixture_fusion::principal::widest;

const LOG_2PI: f64 = 1.837_877_066_409_345_5;

/// Change of the log-likelihood, relative to 1 + |log-likelihood|, at which the iteration stops.
const TOLERANCE: f64 = 1e-6;

/// A component to which fewer points belong than this keeps its moments.
const VANISHED: f64 = 1e-12;

/// Least weight of a component: its logarithm is finite.
const LEAST: f64 = 1e-300;

/// Share of the trace of Σ₂, or of 1 if that is larger, that is added to its diagonal.
const FLOOR: f64 = 1e-9;

/// How often Σ₂ is raised until it has a Cholesky factor.
const ATTEMPTS: usize = 8;

/// Where μ₁ starts; μ₂ and Σ₂ start with the mean and the covariance of all points.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Start {
    /// μ₁ and μ₂ on either side of the mean, one standard deviation along the longest axis of the cloud.
    Split,
    /// The median of every coordinate.
    Median,
    /// The mean.
    Mean,
    /// The fused prediction.
    Prediction,
}

/// The choices that the paper leaves open.
#[derive(Debug, Clone, Copy)]
pub struct Rules {
    /// Where μ₁ starts.
    pub start: Start,
    /// Whether μ₁ weighs points with their precision, which (18) as printed does not.
    pub precise: bool,
    /// Whether Σ₂ stays above the mean variances of P_i rather than above a trace of rounding.
    pub prior_floor: bool,
    /// Iterations at most.
    pub cap: usize,
}

/// How the iteration ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// (14).
    pub likelihood: f64,
    /// Change of it in the last iteration, relative to 1 + its size; infinite after the first.
    pub gap: f64,
    /// Expectation steps.
    pub iterations: usize,
}

impl Outcome {
    /// Whether the iteration stopped before its cap.
    #[must_use]
    pub fn converged(&self) -> bool {
        self.gap < TOLERANCE
    }

    /// Whether the points are so far apart that their likelihood is no number.
    #[must_use]
    pub fn overflowed(&self) -> bool {
        !self.likelihood.is_finite()
    }
}

/// The points of one sample, the parameters and scratch.
#[derive(Debug, Clone)]
pub struct Mixture {
    n: usize,
    /// The sensors whose points there are, (N,) of which `count` count.
    who: Vec<usize>,
    count: usize,
    /// Their points about the mean, (N, n).
    points: Vec<f64>,
    /// The mean.
    centre: Vec<f64>,
    honest: Vec<f64>,
    attacked: Vec<f64>,
    weights: [f64; 2],
    mean: [Vec<f64>; 2],
    /// Σ₂, (n, n).
    spread: Vec<f64>,
    /// Its Cholesky factor; one over it in one dimension.
    factor: Vec<f64>,
    /// What is added to the diagonal of Σ₂ whatever it is, (n,).
    floor: Vec<f64>,
    matrix: Vec<f64>,
    vector: Vec<f64>,
    column: Vec<f64>,
}

impl Mixture {
    /// Room for the points of `sensors` in n dimensions.
    #[must_use]
    pub fn new(sensors: usize, n: usize) -> Self {
        Self {
            n,
            who: vec![0; sensors],
            count: 0,
            points: vec![0.0; sensors * n],
            centre: vec![0.0; n],
            honest: vec![1.0; sensors],
            attacked: vec![0.0; sensors],
            weights: [0.5; 2],
            mean: [vec![0.0; n], vec![0.0; n]],
            spread: vec![0.0; n * n],
            factor: vec![0.0; n * n],
            floor: vec![0.0; n],
            matrix: vec![0.0; n * n],
            vector: vec![0.0; n],
            column: vec![0.0; sensors],
        }
    }

    /// Forget all points.
    pub fn clear(&mut self) {
        self.count = 0;
    }

    /// Add the point of a sensor.
    pub fn add(&mut self, sensor: usize, point: &[f64]) {
        let n = self.n;
        self.who[self.count] = sensor;
        self.points[self.count * n..(self.count + 1) * n].copy_from_slice(point);
        self.count += 1;
    }

    /// How many points there are.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// Sensor, belief that it is honest and belief that it is not, for every point.
    pub fn beliefs(&self) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        let beliefs = self.honest.iter().zip(&self.attacked);
        self.who[..self.count].iter().zip(beliefs).map(|(&who, (&honest, &attacked))| (who, honest, attacked))
    }

    /// Iterate. `known` holds P_i by sensor, `prediction` is where [`Start::Prediction`] starts.
    pub fn fit(&mut self, rules: &Rules, known: &Known, prediction: &[f64]) -> Outcome {
        self.begin(rules, known, prediction);
        let mut outcome = Outcome { likelihood: f64::NEG_INFINITY, gap: f64::INFINITY, iterations: 0 };
        loop {
            let likelihood = self.expect(rules, known);
            outcome = Outcome {
                likelihood,
                gap: (likelihood - outcome.likelihood).abs() / (1.0 + likelihood.abs()),
                iterations: outcome.iterations + 1,
            };
            if outcome.converged() || outcome.overflowed() || outcome.iterations >= rules.cap {
                return outcome;
            }
            self.maximise(rules, known);
        }
    }

    /// Starting values. Points move to their mean, about which nothing cancels.
    fn begin(&mut self, rules: &Rules, known: &Known, prediction: &[f64]) {
        let (n, count) = (self.n, self.count);
        let share = 1.0 / count as f64;
        self.centre.fill(0.0);
        self.points[..count * n].chunks_exact(n).for_each(|point| axpy(share, point, &mut self.centre));
        for point in self.points[..count * n].chunks_exact_mut(n) {
            axpy(-1.0, &self.centre, point);
        }
        self.weights = [0.5; 2];
        self.attacked[..count].fill(1.0);
        self.mean[1].fill(0.0);
        self.scatter(count as f64);
        self.floor.fill(0.0);
        if rules.prior_floor {
            self.who[..count].iter().for_each(|&i| axpy(share, known.variance(i), &mut self.floor));
        }
        match rules.start {
            Start::Mean => self.mean[0].fill(0.0),
            Start::Prediction => {
                self.mean[0].copy_from_slice(prediction);
                axpy(-1.0, &self.centre, &mut self.mean[0]);
            }
            Start::Median => self.median(),
            Start::Split => self.split(),
        }
    }

    fn median(&mut self) {
        let (n, count) = (self.n, self.count);
        let column = &mut self.column[..count];
        for (j, target) in self.mean[0].iter_mut().enumerate() {
            column.iter_mut().zip(self.points[j..].iter().step_by(n)).for_each(|(to, from)| *to = *from);
            column.sort_unstable_by(f64::total_cmp);
            *target = 0.5 * (column[(count - 1) / 2] + column[count / 2]);
        }
    }

    fn split(&mut self) {
        let [first, second] = &mut self.mean;
        if self.n == 1 {
            second[0] = self.spread[0].sqrt();
        } else {
            self.matrix.copy_from_slice(&self.spread);
            widest(&mut self.matrix, &mut self.factor, self.n, second);
        }
        first.iter_mut().zip(second).for_each(|(first, second)| *first = -*second);
    }

    /// (15), (16) and the likelihood (14), with one exponential per point.
    fn expect(&mut self, rules: &Rules, known: &Known) -> f64 {
        let second = self.weights[1].max(LEAST).ln() - 0.5 * self.factorise(rules);
        let first = self.weights[0].max(LEAST).ln();
        let (n, count) = (self.n, self.count);
        let mut likelihood = -0.5 * (n * count) as f64 * LOG_2PI;
        let mut product = LogProduct::default();
        for (j, point) in self.points[..count * n].chunks_exact(n).enumerate() {
            let sensor = self.who[j];
            difference(point, &self.mean[0], &mut self.vector);
            let honest = first - 0.5 * (known.log_det(sensor) + known.distance(sensor, &self.vector));
            difference(point, &self.mean[1], &mut self.vector);
            let attacked = second - 0.5 * distance(&self.factor, &mut self.vector);
            let odds = attacked - honest;
            let ratio = (-odds.abs()).exp();
            let larger = 1.0 / (1.0 + ratio);
            let smaller = ratio * larger;
            (self.honest[j], self.attacked[j]) =
                if odds > 0.0 { (smaller, larger) } else { (larger, smaller) };
            likelihood += honest.max(attacked);
            product.multiply(1.0 + ratio);
        }
        likelihood + product.log()
    }

    /// The Cholesky factor of Σ₂ above its floor; returns the logarithm of its determinant.
    fn factorise(&mut self, rules: &Rules) -> f64 {
        let n = self.n;
        let trace: f64 = self.spread.iter().step_by(n + 1).sum();
        let added = if rules.prior_floor { 0.0 } else { FLOOR * trace.max(1.0) };
        if n == 1 {
            let sum = self.spread[0] + self.floor[0] + added;
            let variance = if sum == 0.0 { FLOOR } else { sum };
            self.factor[0] = 1.0 / variance.sqrt();
            return variance.ln();
        }
        let mut more = 0.0;
        for _ in 0..ATTEMPTS {
            self.factor.copy_from_slice(&self.spread);
            for (j, floor) in self.floor.iter().enumerate() {
                self.factor[j * n + j] += floor + added + more;
            }
            if cholesky(&mut self.factor, n, n, 0.0).is_ok() {
                break;
            }
            // The prior says nothing of some direction: the same trace of rounding as without it, or more.
            more = (10.0 * more).max(FLOOR * trace.max(1.0));
        }
        let mut product = LogProduct::default();
        self.factor.iter().step_by(n + 1).for_each(|&pivot| product.multiply(pivot));
        2.0 * product.log()
    }

    /// (17)–(19).
    fn maximise(&mut self, rules: &Rules, known: &Known) {
        let count = self.count;
        let honest: f64 = self.honest[..count].iter().sum();
        let attacked: f64 = self.attacked[..count].iter().sum();
        self.weights = [honest / count as f64, attacked / count as f64];
        if honest > VANISHED {
            if rules.precise {
                self.precise_mean(known);
            } else {
                average(&self.points, &self.honest[..count], honest, &mut self.mean[0]);
            }
        }
        if attacked > VANISHED {
            average(&self.points, &self.attacked[..count], attacked, &mut self.mean[1]);
            self.scatter(attacked);
        }
    }

    /// Σ₂ about μ₂.
    fn scatter(&mut self, total: f64) {
        let (n, count, share) = (self.n, self.count, 1.0 / total);
        self.spread.fill(0.0);
        for (point, &weight) in self.points[..count * n].chunks_exact(n).zip(&self.attacked) {
            difference(point, &self.mean[1], &mut self.vector);
            for (row, &value) in self.spread.chunks_exact_mut(n).zip(&self.vector) {
                axpy(weight * share * value, &self.vector, row);
            }
        }
    }

    /// μ₁ as the maximiser of the expected likelihood.
    fn precise_mean(&mut self, known: &Known) {
        let (n, count) = (self.n, self.count);
        if n == 1 {
            let (mut total, mut sum) = (0.0, 0.0);
            for (j, point) in self.points[..count].iter().enumerate() {
                let weight = self.honest[j] * known.precision(self.who[j])[0];
                total += weight;
                sum += weight * point;
            }
            self.mean[0][0] = sum / total;
            return;
        }
        self.matrix.fill(0.0);
        self.vector.fill(0.0);
        for (j, point) in self.points[..count * n].chunks_exact(n).enumerate() {
            let (weight, precision) = (self.honest[j], known.precision(self.who[j]));
            axpy(weight, precision, &mut self.matrix);
            for (row, target) in precision.chunks_exact(n).zip(&mut self.vector) {
                *target += weight * dot(row, point);
            }
        }
        if cholesky(&mut self.matrix, n, n, 0.0).is_ok() {
            cholesky_solve(&self.matrix, n, &mut self.vector);
            self.mean[0].copy_from_slice(&self.vector);
        }
    }
}

fn difference(a: &[f64], b: &[f64], out: &mut [f64]) {
    for ((target, a), b) in out.iter_mut().zip(a).zip(b) {
        *target = a - b;
    }
}

/// dᵀ (L Lᵀ)⁻¹ d, where `factor` is L, or 1/L in one dimension; d is destroyed.
fn distance(factor: &[f64], d: &mut [f64]) -> f64 {
    if let [value] = d {
        let part = *value * factor[0];
        return part * part;
    }
    forward_solve(factor, d.len(), d);
    dot(d, d)
}

/// Σ weight_i x_i / total
fn average(points: &[f64], weights: &[f64], total: f64, out: &mut [f64]) {
    out.fill(0.0);
    for (point, weight) in points.chunks_exact(out.len()).zip(weights) {
        axpy(*weight, point, out);
    }
    out.iter_mut().for_each(|value| *value /= total);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::ud::Ud;

    const POINTS: [f64; 8] = [0.1, -0.2, 0.3, 0.05, -0.4, 6.0, 5.5, 7.2];

    fn rules(precise: bool, cap: usize) -> Rules {
        Rules { start: Start::Median, precise, prior_floor: false, cap }
    }

    /// The case `em_plain` or `em_precision` of tests/cases/mixture/golden.json, stopped after `cap` iterations.
    fn fit(precise: bool, cap: usize) -> (Mixture, Outcome) {
        let (mut mixture, mut known) = (Mixture::new(8, 1), Known::new(8, 1, precise));
        for (i, point) in POINTS.iter().enumerate() {
            known.set(i, &Ud { u: vec![0.0], d: vec![0.2 + 0.05 * i as f64] });
            mixture.add(i, &[*point]);
        }
        let outcome = mixture.fit(&rules(precise, cap), &known, &[0.0]);
        (mixture, outcome)
    }

    fn assert_case(precise: bool, trace: [f64; 6], mean: [f64; 2], spread: f64, attacked: [f64; 3]) {
        for (i, want) in trace.iter().enumerate() {
            let (_, outcome) = fit(precise, i + 1);
            assert!((outcome.likelihood - want).abs() < 1e-9, "iteration {}: {}", i + 1, outcome.likelihood);
        }
        let (mixture, outcome) = fit(precise, 100);
        assert_eq!(outcome.iterations, 6);
        assert!(outcome.converged());
        let centre = mixture.centre[0];
        for (got, want) in mixture.mean.iter().zip(mean) {
            assert!((got[0] + centre - want).abs() < 1e-9, "{} {want}", got[0] + centre);
        }
        assert!((mixture.spread[0] - spread).abs() < 1e-9);
        assert!((mixture.weights[1] - 0.375).abs() < 1e-9);
        let beliefs: Vec<_> = mixture.beliefs().collect();
        for (i, honest, attacked) in &beliefs[..5] {
            assert!((honest - 1.0).abs() < 1e-9 && attacked.abs() < 1e-9, "{i}");
        }
        for ((_, honest, _), want) in beliefs[5..].iter().zip(attacked) {
            assert!((honest / want - 1.0).abs() < 1e-6, "{honest} {want}");
        }
    }

    #[test]
    fn the_mean_as_printed_gives_the_numbers_of_an_independent_program() {
        let trace = [
            -15.810362660782074,
            -13.228659514904248,
            -11.512271395406149,
            -10.50966033322796,
            -10.509634692102317,
            -10.509634692102317,
        ];
        let honest = [5.319300484455819e-18, 1.4929095183249612e-13, 9.240281730645854e-21];
        assert_case(false, trace, [-0.029999999999834902, 6.233333333333369], 0.5088888888888927, honest);
    }

    #[test]
    fn the_precise_mean_gives_the_numbers_of_an_independent_program() {
        let trace = [
            -15.810362660782074,
            -13.22702557682003,
            -11.506970471133005,
            -10.505712568570733,
            -10.505690320827583,
            -10.505690320827583,
        ];
        let honest = [7.055555859703477e-18, 1.8848269788527923e-13, 1.2191765533169967e-20];
        assert_case(true, trace, [-0.008882907133125744, 6.233333333333378], 0.5088888888888923, honest);
    }

    #[test]
    fn points_that_are_the_same_are_honest() {
        let (mut mixture, mut known) = (Mixture::new(3, 2), Known::new(3, 2, true));
        for i in 0..3 {
            known.set(i, &Ud { u: vec![0.0; 4], d: vec![1e-18, 0.0] });
            mixture.add(i, &[1e9, -3.0]);
        }
        let outcome = mixture.fit(&rules(true, 50), &known, &[0.0, 0.0]);
        assert!(outcome.converged());
        assert!(mixture.beliefs().all(|(_, honest, _)| honest > 0.9));
    }
}
