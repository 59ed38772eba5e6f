//! The factored covariance: positive semidefinite for as long as one likes, and equal to the textbook's.
#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use securestate_kernels::kalman::model::{Matrices, Model};
use securestate_kernels::kalman::ud::Ud;
use securestate_kernels::kalman::{Kalman, State};
use securestate_kernels::{Estimator, Record};

const SENSORS: [f64; 4] = [1e-8, 1e-3, 1.0, 1e8]; // variances of four channels

/// Two positions with velocities, almost no process noise, four channels whose noise spans 16 decades.
fn stiff() -> Matrices {
    #[rustfmt::skip]
    let (a, c) = (
        vec![1.0, 1.0, 0.0, 0.0,  0.0, 1.0, 0.0, 0.0,  0.0, 0.0, 1.0, 0.01,  0.0, 0.0, -0.01, 1.0],
        vec![1.0, 0.0, 0.0, 0.0,  1.0, 0.0, 1e-4, 0.0,  0.0, 0.0, 1.0, 0.0,  1.0, 1.0, 1.0, 1.0],
    );
    let mut r = vec![0.0; 16];
    SENSORS.iter().enumerate().for_each(|(i, v)| r[5 * i] = *v);
    let mut q = vec![0.0; 16];
    q[5] = 1e-14; // Q is singular: only one velocity is disturbed
    let channel_sensor = (0..4).collect();
    Matrices { a, b: vec![], c, d: vec![], q, r, channel_sensor, sensors: 4, states: 4 }
}

/// Eigenvalues of a symmetric matrix by Jacobi's rotations.
fn eigenvalues(mut a: Vec<f64>, n: usize) -> Vec<f64> {
    for _ in 0..30 {
        for p in 0..n {
            for q in p + 1..n {
                let angle = 0.5 * (2.0 * a[p * n + q]).atan2(a[q * n + q] - a[p * n + p]);
                let (s, c) = angle.sin_cos();
                for k in 0..n {
                    let (x, y) = (a[k * n + p], a[k * n + q]);
                    (a[k * n + p], a[k * n + q]) = (c * x - s * y, s * x + c * y);
                }
                for k in 0..n {
                    let (x, y) = (a[p * n + k], a[q * n + k]);
                    (a[p * n + k], a[q * n + k]) = (c * x - s * y, s * x + c * y);
                }
            }
        }
    }
    (0..n).map(|i| a[i * n + i]).collect()
}

/// Smallest eigenvalue of the correlations of `p`.
fn smallest_correlation_eigenvalue(p: &[f64], n: usize) -> f64 {
    let std: Vec<f64> = (0..n).map(|i| p[i * n + i].sqrt()).collect();
    let correlations = (0..n * n).map(|k| p[k] / std[k / n] / std[k % n]).collect();
    eigenvalues(correlations, n).into_iter().fold(f64::INFINITY, f64::min)
}

fn identity(n: usize) -> Vec<f64> {
    (0..n * n).map(|i| if i % (n + 1) == 0 { 1.0 } else { 0.0 }).collect()
}

/// A pseudorandom bit pattern per sample.
fn scramble(k: u64) -> u64 {
    let z = (k + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    (z ^ (z >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 32
}

#[test]
fn p_stays_positive_semidefinite_over_a_million_ill_conditioned_steps() {
    let filter = Kalman::new(Model::new(stiff()).unwrap(), None).unwrap();
    let mut state = filter.start(&[0.0; 4], Some(&identity(4))).unwrap();
    let mut record = Record::new(filter.dims(), 3, 1, 1, true);
    let mut least = f64::INFINITY;
    for k in 0..1_000_000_u64 {
        let pattern = scramble(k);
        let y: [f64; 4] = std::array::from_fn(|i| if pattern >> i & 1 == 1 { 0.0 } else { f64::NAN });
        filter.step(&mut state, &y, &[], &mut record.split()[0].at(0)).unwrap();
        assert!(record.x_std.iter().all(|s| s.is_finite() && *s >= 0.0), "sample {k}");
        if k % 500 == 0 {
            least = least.min(smallest_correlation_eigenvalue(&record.covariance, 4));
        }
    }
    assert!(least > -1e-14, "smallest eigenvalue {least:e}");
}

/// Steps over `y` (T, m); what every step reported.
fn reports(filter: &Kalman, state: &mut State, y: &[f64]) -> Vec<Record> {
    let dims = filter.dims();
    y.chunks(dims.channels)
        .map(|row| {
            let mut record = Record::new(dims, 3, 1, 1, true);
            filter.step(state, row, &[], &mut record.split()[0].at(0)).unwrap();
            record
        })
        .collect()
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|v| v.to_bits()).collect()
}

#[test]
fn planned_steps_equal_plain_steps_to_the_bit_and_leave_the_same_state() {
    let filter = Kalman::new(Model::new(stiff()).unwrap(), None).unwrap();
    let start = filter.start(&[0.0; 4], Some(&identity(4))).unwrap();
    let gap = |k: u64| k % 9 == 4 || (300..310).contains(&k);
    let y: Vec<f64> = (0..4 * 400_u64)
        .map(|i| if gap(i / 4) && i % 4 < 3 { f64::NAN } else { scramble(i) as f64 * 1e-9 })
        .collect();
    let (mut plain, mut planned) = (start.clone(), start.clone());
    let expected = reports(&filter, &mut plain, &y);
    let plan = filter.plan(&[&start, &start], &[&y[..], &y], 400).unwrap();
    for (k, row) in y.chunks(4).enumerate() {
        let mut record = Record::new(filter.dims(), 3, 1, 1, true);
        filter.step_planned(&plan, k, &mut planned, row, &[], &mut record.split()[0].at(0)).unwrap();
        assert_eq!(bits(&record.x), bits(&expected[k].x), "x at {k}");
        assert_eq!(bits(&record.covariance), bits(&expected[k].covariance), "P at {k}");
        assert_eq!(bits(&record.diagnostics), bits(&expected[k].diagnostics), "diagnostics at {k}");
    }
    filter.leave_plan(&plan, &mut planned);
    let (next, again) = (reports(&filter, &mut plain, &y), reports(&filter, &mut planned, &y));
    assert!(next.iter().zip(&again).all(|(a, b)| bits(&a.x) == bits(&b.x)));
}

#[test]
fn runs_that_differ_in_covariance_or_in_gaps_share_nothing() {
    let filter = Kalman::new(Model::new(stiff()).unwrap(), None).unwrap();
    let one = filter.start(&[0.0; 4], Some(&identity(4))).unwrap();
    let wide: Vec<f64> = identity(4).iter().map(|v| v * (1.0 + f64::EPSILON)).collect();
    let two = filter.start(&[0.0; 4], Some(&wide)).unwrap();
    let mut gaps = [0.0; 16];
    gaps[13] = f64::NAN;
    assert!(filter.plan(&[&one, &one], &[&[0.0; 8][..]; 2], 2).is_some());
    assert!(filter.plan(&[&one, &two], &[&[0.0; 8][..]; 2], 2).is_none());
    assert!(filter.plan(&[&one, &one], &[&gaps[..8], &gaps[8..]], 2).is_none());
}

proptest! {
    #[test]
    fn a_factored_covariance_is_the_covariance(
        n in 1_usize..8, rank in 1_usize..8, g in prop::collection::vec(-2.0..2.0_f64, 64),
    ) {
        let mut p = vec![0.0; n * n];
        for (k, value) in p.iter_mut().enumerate() {
            *value = (0..rank).map(|l| g[8 * (k / n) + l] * g[8 * (k % n) + l]).sum();
        }
        let mut back = vec![0.0; n * n];
        Ud::new("P", &p, n).unwrap().covariance(&mut back);
        for (k, (got, want)) in back.iter().zip(&p).enumerate() {
            let size = (p[k / n * (n + 1)] * p[k % n * (n + 1)]).sqrt();
            prop_assert!((got - want).abs() <= 1e-13 * size, "{got} instead of {want}");
        }
    }

    #[test]
    fn an_indefinite_matrix_is_refused(n in 2_usize..8, size in 1e-3..1e3_f64) {
        let mut p = identity(n);
        p[1] = 1.0 + size;
        p[n] = 1.0 + size;
        prop_assert!(Ud::new("P", &p, n).is_err());
    }
}
