//! A batch of the Kalman filter equals its runs to the bit, whatever they share.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use securestate_kernels::kalman::Kalman;
use securestate_kernels::kalman::model::{Matrices, Model};
use securestate_kernels::{Block, Design, Kernel, Record, Units};

const RUNS: usize = 21;
const STEPS: usize = 60;
const P: usize = 2;
const UNCHECKABLE: usize = 1;

/// Numbers between −1 and 1, the same every time.
fn numbers(count: usize, seed: u64) -> Vec<f64> {
    let scramble =
        |i: u64| (i + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(31).wrapping_mul(seed | 1);
    (0..count as u64).map(|i| (scramble(i) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0).collect()
}

fn diagonal(n: usize, value: f64) -> Vec<f64> {
    (0..n * n).map(|i| if i % (n + 1) == 0 { value } else { 0.0 }).collect()
}

/// Correlated noise, inputs and an operating point.
fn kernel(n: usize, m: usize) -> Arc<dyn Kernel> {
    let mut r = diagonal(m, 2.0);
    (r[1], r[m]) = (0.7, 0.7);
    let matrices = Matrices {
        a: numbers(n * n, 3).iter().map(|v| v / n as f64).collect(),
        b: numbers(n * P, 5),
        c: numbers(m * n, 7),
        d: numbers(m * P, 9),
        q: diagonal(n, 0.3),
        r,
        channel_sensor: (0..m).collect(),
        sensors: m,
        states: n,
    };
    let scale = |count, seed| numbers(count, seed).iter().map(|v| v + 2.0).collect();
    let units = Units {
        offset: numbers(m, 11),
        scale: scale(m, 13),
        input_offset: numbers(P, 15),
        input_scale: scale(P, 17),
        uncheckable: vec![UNCHECKABLE],
    };
    Design::boxed(Kalman::new(Model::new(matrices).unwrap(), None).unwrap(), units).unwrap()
}

/// Samples in blocks that end at `cuts`.
fn run(kernel: &dyn Kernel, y: &[f64], u: &[f64], cuts: &[usize]) -> Record {
    let dims = kernel.dims();
    let runs = y.len() / (STEPS * dims.channels);
    let mut record = Record::new(dims, kernel.diagnostics().len(), runs, STEPS, true);
    let mut filter = kernel.start(&vec![0.5; runs * dims.states], Some(&diagonal(dims.states, 1.0))).unwrap();
    let mut from = 0;
    for &to in cuts {
        filter.advance(Block { y, u, steps: STEPS }, from, to, &mut record).unwrap();
        from = to;
    }
    record
}

fn bits(record: &Record) -> Vec<u64> {
    let floats = [
        &record.x,
        &record.x_std,
        &record.covariance,
        &record.trust,
        &record.attack,
        &record.attack_std,
        &record.innovation,
        &record.innovation_std,
        &record.diagnostics,
    ];
    let bytes = record.suspected.iter().chain(&record.status).map(|&byte| u64::from(byte));
    floats.into_iter().flatten().map(|value| value.to_bits()).chain(bytes).collect()
}

/// The batch run by run against every run alone; whether it kept one copy of what the runs share.
fn check(n: usize, m: usize, y: &[f64], u: &[f64], cuts: &[usize]) -> bool {
    let kernel = kernel(n, m);
    let mut batch = run(&*kernel, y, u, cuts);
    let shared = batch.copies == 1;
    batch.unshare();
    let share = |values: &[f64], r: usize| values.chunks(values.len() / RUNS).nth(r).unwrap().to_vec();
    let bytes = |values: &[u8], r: usize| values.chunks(values.len() / RUNS).nth(r).unwrap().to_vec();
    for r in 0..RUNS {
        let u = if u.len() == STEPS * P { u } else { &u[r * STEPS * P..(r + 1) * STEPS * P] };
        let alone = run(&*kernel, &y[r * STEPS * m..(r + 1) * STEPS * m], u, &[STEPS]);
        let mine = Record {
            dims: batch.dims,
            runs: 1,
            steps: STEPS,
            copies: 1,
            x: share(&batch.x, r),
            x_std: share(&batch.x_std, r),
            covariance: share(&batch.covariance, r),
            trust: share(&batch.trust, r),
            attack: share(&batch.attack, r),
            attack_std: share(&batch.attack_std, r),
            suspected: bytes(&batch.suspected, r),
            innovation: share(&batch.innovation, r),
            innovation_std: share(&batch.innovation_std, r),
            diagnostics: share(&batch.diagnostics, r),
            status: bytes(&batch.status, r),
        };
        assert!(bits(&mine) == bits(&alone), "n={n} m={m} run {r}");
    }
    shared
}

#[test]
fn runs_that_share_their_gaps_equal_single_runs_to_the_bit() {
    for (n, m) in [(1, 2), (4, 5), (7, 3), (8, 16), (19, 23)] {
        let mut y = numbers(RUNS * STEPS * m, 19);
        for run in y.chunks_mut(STEPS * m) {
            run[20 * m + 1..22 * m].fill(f64::NAN); // a channel is left at 20, none at 21
        }
        assert!(check(n, m, &y, &numbers(STEPS * P, 21), &[STEPS]));
        assert!(check(n, m, &y, &numbers(RUNS * STEPS * P, 23), &[21, 50, STEPS]));
    }
}

#[test]
fn a_sensor_that_cannot_be_checked_has_no_trust_in_any_run_of_a_plan() {
    let (n, m) = (4, 5);
    let y = numbers(RUNS * STEPS * m, 31);
    let mut batch = run(&*kernel(n, m), &y, &numbers(STEPS * P, 33), &[STEPS]);
    batch.unshare();
    for trust in batch.trust.chunks(m) {
        assert!(trust[UNCHECKABLE].is_nan() && trust.iter().filter(|&&trust| trust == 1.0).count() == m - 1);
    }
}

#[test]
fn a_sensor_that_does_not_exist_cannot_be_uncheckable() {
    let model = Model::new(Matrices {
        a: vec![0.5],
        b: vec![],
        c: vec![1.0],
        d: vec![],
        q: vec![1.0],
        r: vec![1.0],
        channel_sensor: vec![0],
        sensors: 1,
        states: 1,
    });
    let units = Units {
        offset: vec![0.0],
        scale: vec![1.0],
        input_offset: vec![],
        input_scale: vec![],
        uncheckable: vec![1],
    };
    let refused = Design::boxed(Kalman::new(model.unwrap(), None).unwrap(), units).err().unwrap().to_string();
    assert_eq!(refused, "uncheckable: expected sensors in 0..1, received 1");
}

#[test]
fn runs_that_part_on_the_way_equal_single_runs_to_the_bit() {
    let (n, m) = (4, 5);
    let mut y = numbers(RUNS * STEPS * m, 25);
    y[(13 * STEPS + 30) * m] = f64::NAN;
    assert!(!check(n, m, &y, &numbers(STEPS * P, 27), &[20, 40, STEPS]));
    assert!(!check(n, m, &y, &numbers(STEPS * P, 27), &[STEPS]));
}

#[test]
fn an_infinite_measurement_in_a_batch_is_refused_with_channel_sample_and_run() {
    let (kernel, mut y) = (kernel(4, 5), numbers(RUNS * STEPS * 5, 29));
    y[(13 * STEPS + 30) * 5 + 2] = f64::INFINITY;
    let mut filter = kernel.start(&[0.0; 4 * RUNS], Some(&diagonal(4, 1.0))).unwrap();
    let mut record = Record::new(kernel.dims(), 3, RUNS, STEPS, false);
    let block = Block { y: &y, u: &[0.0; STEPS * P], steps: STEPS };
    let error = filter.advance(block, 0, STEPS, &mut record).unwrap_err().to_string();
    assert!(error.contains("channel 2 at sample 30 of run 13"), "{error}");
}
