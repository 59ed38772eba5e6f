//! A step of any estimator allocates nothing: an allocator counts.
#![allow(clippy::unwrap_used)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use securestate_kernels::adaptive_joint::{AdaptiveJoint, Settings};
use securestate_kernels::augmented::Augmented;
use securestate_kernels::augmented::drift::Forgetting;
use securestate_kernels::augmented::report::Report;
use securestate_kernels::bias_monitor::scan::Rule as Statistic;
use securestate_kernels::bias_monitor::verdict::Law;
use securestate_kernels::bias_monitor::{BiasMonitor, Design as MonitorDesign};
use securestate_kernels::detectors::local::LocalFilter;
use securestate_kernels::detectors::{Detector, Rule};
use securestate_kernels::joint_fusion::JointFusion;
use securestate_kernels::joint_fusion::choice::Choice;
use securestate_kernels::joint_fusion::covariance::{Design as Recursions, Form};
use securestate_kernels::joint_fusion::fusion::Rule as Fusion;
use securestate_kernels::joint_fusion::layout::Layout as Stacks;
use securestate_kernels::kalman::Kalman;
use securestate_kernels::kalman::model::{Matrices, Model};
use securestate_kernels::mixture::Mixture;
use securestate_kernels::mixture::settings::{Attacked, Form as Sweeps, Memory, Settings as BeliefSettings};
use securestate_kernels::mixture_fusion::em::{Rules, Start};
use securestate_kernels::mixture_fusion::{MixtureFusion, Settings as MixtureSettings};
use securestate_kernels::projection::{Blocks, Projection};
use securestate_kernels::protected::Protected;
use securestate_kernels::secure::{Secure, settings::Settings as SecureSettings};
use securestate_kernels::sparse_fusion::{self, SparseFusion};
use securestate_kernels::{Design, Dims, Kernel, Record, Units};

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

fn count() {
    let _ = ALLOCATIONS.try_with(|n| n.set(n.get() + 1));
}

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        unsafe { System.alloc(layout) }
    }
    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        unsafe { System.realloc(pointer, layout, size) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Allocations of `body` on this thread.
fn allocations(body: impl FnOnce()) -> usize {
    let before = ALLOCATIONS.with(Cell::get);
    body();
    ALLOCATIONS.with(Cell::get) - before
}

/// Steps a filter over 60 samples, some channels or all of them missing now and then; counts allocations.
fn allocations_of_steps(kernel: &dyn Kernel, prior: Option<&[f64]>) -> usize {
    let Dims { states, channels, inputs, .. } = kernel.dims();
    let mut filter = kernel.start(&vec![0.0; states], prior).unwrap();
    let mut record = Record::new(kernel.dims(), kernel.diagnostics().len(), 1, 1, true);
    let mut views = record.split();
    let (mut y, u) = (vec![0.0; channels], vec![0.5; inputs]);
    let mut total = 0;
    for k in 0..60 {
        for (i, value) in y.iter_mut().enumerate() {
            let missing = k % 20 == 7 || (k % 10 == 3 && i % 2 == 0);
            let attacked = if i == 0 && k % 7 == 0 { 50.0 } else { 0.0 };
            *value = if missing { f64::NAN } else { ((k * 13 + i * 7) % 11) as f64 / 11.0 + attacked };
        }
        let mut out = views[0].at(0);
        total += allocations(|| filter.step(&y, &u, &mut out).unwrap());
    }
    total
}

fn identity(n: usize) -> Vec<f64> {
    (0..n * n).map(|i| if i % (n + 1) == 0 { 1.0 } else { 0.0 }).collect()
}

/// n states in a chain, every channel sees two of them, neighbouring channels are correlated, two channels per sensor.
fn model(states: usize, channels: usize) -> Model {
    Model::new(matrices(states, channels)).unwrap()
}

fn matrices(states: usize, channels: usize) -> Matrices {
    let (n, m) = (states, channels);
    let (mut a, mut c, mut r) = (identity(n), vec![0.0; m * n], identity(m));
    a.iter_mut().for_each(|value| *value *= 0.9);
    for i in 0..m {
        c[i * n + i % n] = 1.0;
        c[i * n + (i + 1) % n] = 0.5;
        if i > 0 {
            r[i * m + i - 1] = 0.3;
            r[(i - 1) * m + i] = 0.3;
        }
    }
    Matrices {
        a,
        b: vec![0.1; n],
        c,
        d: vec![0.2; m],
        q: identity(n),
        r,
        channel_sensor: (0..m).map(|i| i / 2).collect(),
        sensors: m.div_ceil(2),
        states,
    }
}

/// The operating point of `m` channels and one input in normalised units.
fn plain_units(m: usize) -> Units {
    Units {
        offset: vec![0.0; m],
        scale: vec![1.0; m],
        input_offset: vec![0.0],
        input_scale: vec![1.0],
        uncheckable: vec![0],
    }
}

fn kalman(states: usize, channels: usize) -> std::sync::Arc<dyn Kernel> {
    let estimator = Kalman::new(model(states, channels), Some(&identity(states))).unwrap();
    Design::boxed(estimator, plain_units(channels)).unwrap()
}

#[test]
fn the_counter_counts() {
    assert_eq!(allocations(|| drop(std::hint::black_box(vec![0; 9]))), 1);
}

#[test]
fn a_kalman_step_allocates_nothing() {
    for (n, m) in [(1, 1), (4, 5), (12, 30)] {
        let kernel = kalman(n, m);
        assert_eq!(allocations_of_steps(kernel.as_ref(), None), 0, "steady ({n}, {m})");
        let prior = identity(n);
        assert_eq!(allocations_of_steps(kernel.as_ref(), Some(&prior)), 0, "prior ({n}, {m})");
    }
}

fn quantiles(channels: usize) -> Vec<f64> {
    (0..=channels).map(|count| if count == 0 { f64::INFINITY } else { 6.0 }).collect()
}

/// A detector whose local filters see every state.
fn detector(states: usize, channels: usize, rule: Rule) -> std::sync::Arc<dyn Kernel> {
    let filter = Kalman::new(model(states, channels), Some(&identity(states))).unwrap();
    let detector = Detector::new(filter, rule, quantiles(channels)).unwrap();
    Design::boxed(detector, plain_units(channels)).unwrap()
}

#[test]
fn an_adaptive_step_allocates_nothing_whoever_is_protected() {
    for (n, m) in [(1, 1), (4, 5), (12, 30)] {
        for every in [1, 2, 3] {
            let filter = Kalman::new(model(n, m), Some(&identity(n))).unwrap();
            let protected = (0..m.div_ceil(2)).map(|sensor| sensor % every == 0).collect();
            let settings = Settings { protected, window: 7, gate: 9.0, quantiles: quantiles(m) };
            let kernel =
                Design::boxed(AdaptiveJoint::new(filter, settings).unwrap(), plain_units(m)).unwrap();
            assert_eq!(allocations_of_steps(kernel.as_ref(), None), 0, "steady ({n}, {m}), 1 in {every}");
            let prior = identity(n);
            assert_eq!(
                allocations_of_steps(kernel.as_ref(), Some(&prior)),
                0,
                "prior ({n}, {m}), 1 in {every}"
            );
        }
    }
}

fn local_filters(n: usize, m: usize) -> Vec<LocalFilter> {
    let filter = |channels: usize| LocalFilter {
        t: identity(n),
        a: identity(n).iter().map(|one| 0.9 * one).collect(),
        b: vec![0.1; n],
        c: vec![0.5; channels * n],
        d: vec![0.2; channels],
        gain: vec![0.1; n * channels],
        innovation_cov: identity(channels),
    };
    (0..m.div_ceil(2)).map(|sensor| filter((m - 2 * sensor).min(2))).collect()
}

#[test]
fn a_detector_step_allocates_nothing_alarmed_or_not() {
    for (n, m) in [(1, 1), (4, 5), (12, 30)] {
        for rule in [
            Rule::Gate,
            Rule::Local { filters: local_filters(n, m), hold: false },
            Rule::Local { filters: local_filters(n, m), hold: true },
            Rule::Central { drop_worst: false },
            Rule::Central { drop_worst: true },
        ] {
            let kernel = detector(n, m, rule.clone());
            assert_eq!(allocations_of_steps(kernel.as_ref(), None), 0, "steady ({n}, {m}) {rule:?}");
            let prior = identity(n);
            assert_eq!(allocations_of_steps(kernel.as_ref(), Some(&prior)), 0, "prior ({n}, {m}) {rule:?}");
        }
    }
}

/// Mixture fusion of sensors whose noise is independent.
fn mixture_fusion(
    (states, channels): (usize, usize),
    feedback: bool,
    settings: MixtureSettings,
) -> std::sync::Arc<dyn Kernel> {
    let (n, m) = (states, channels);
    let mut given = matrices(n, m);
    (0..m * m).filter(|k| k / m / 2 != k % m / 2).for_each(|k| given.r[k] = 0.0);
    let filter = Kalman::new(Model::new(given).unwrap(), Some(&identity(n))).unwrap();
    let priors = identity(n).repeat(m.div_ceil(2));
    let estimator = MixtureFusion::new(filter, (!feedback).then_some(&priors[..]), settings).unwrap();
    Design::boxed(estimator, plain_units(m)).unwrap()
}

#[test]
fn a_mixture_fusion_step_allocates_nothing_with_any_settings() {
    for (n, m) in [(1, 6), (4, 9), (12, 30)] {
        for (start, precise, prior_floor) in [
            (Start::Split, false, false),
            (Start::Median, true, true),
            (Start::Mean, true, false),
            (Start::Prediction, false, true),
        ] {
            for (literal, feedback) in [(false, false), (true, false), (false, true)] {
                let rules = Rules { start, precise, prior_floor, cap: 30 };
                let settings = MixtureSettings { epsilon: Some(0.2), literal, start: 5, rules };
                let kernel = mixture_fusion((n, m), feedback, settings);
                let name = format!("({n}, {m}) {settings:?} {feedback}");
                assert_eq!(allocations_of_steps(kernel.as_ref(), None), 0, "steady {name}");
                let prior = identity(n);
                assert_eq!(allocations_of_steps(kernel.as_ref(), Some(&prior)), 0, "prior {name}");
            }
        }
    }
}

/// A filter whose last state is what is injected into the first channel.
fn augmented(states: usize, channels: usize, factor: Option<f64>) -> std::sync::Arc<dyn Kernel> {
    let (filter, start) = (Kalman::new(model(states, channels), Some(&identity(states))).unwrap(), vec![1.0]);
    let mut quantiles = vec![6.0; channels + 1];
    quantiles[0] = f64::INFINITY;
    let report = Report { states: states - 1, weak: vec![0], quantiles };
    let forgetting = factor.map(|factor| Forgetting { factor, start: start.clone() });
    let estimator = Augmented::new(filter, report, start, forgetting).unwrap();
    Design::boxed(estimator, plain_units(channels)).unwrap()
}

fn innovation_mixture(
    (states, channels): (usize, usize),
    settings: BeliefSettings,
) -> std::sync::Arc<dyn Kernel> {
    let (n, m) = (states, channels);
    let mut given = matrices(n, m);
    (0..m * m).filter(|k| k / m / 2 != k % m / 2).for_each(|k| given.r[k] = 0.0);
    let estimator = Mixture::new(Model::new(given).unwrap(), Some(&identity(n)), settings).unwrap();
    Design::boxed(estimator, plain_units(m)).unwrap()
}

#[test]
fn an_innovation_mixture_step_allocates_nothing_with_any_settings() {
    for (n, m) in [(1_usize, 6_usize), (4, 9), (12, 30)] {
        for form in [Sweeps::Propagation, Sweeps::Weight] {
            for (attacked, memory, merge, monitor) in [
                (Attacked::Learned, Memory::Rate, true, None),
                (Attacked::Student, Memory::Sticky, true, Some(0.9)),
                (Attacked::Learned, Memory::Sticky, false, Some(0.5)),
            ] {
                let mut protected = vec![false; m.div_ceil(2)];
                protected[1] = merge;
                let settings = BeliefSettings {
                    form,
                    attacked,
                    memory,
                    merge,
                    kappa: 5.0,
                    forgetting: 0.98,
                    monitor,
                    cap: 15,
                    tolerance: 1e-3,
                    student: vec![-0.3; 3],
                    degrees: 1.0,
                    quantiles: vec![f64::INFINITY, 0.5, 0.8],
                    protected,
                };
                let name = format!("({n}, {m}) {settings:?}");
                let kernel = innovation_mixture((n, m), settings);
                assert_eq!(allocations_of_steps(kernel.as_ref(), None), 0, "steady {name}");
                let prior = identity(n);
                assert_eq!(allocations_of_steps(kernel.as_ref(), Some(&prior)), 0, "prior {name}");
            }
        }
    }
}

fn secure_filter(states: usize, channels: usize, every: usize) -> std::sync::Arc<dyn Kernel> {
    let (n, m) = (states, channels);
    let (mut given, sensors) = (matrices(n, m), m.div_ceil(2));
    (0..m * m).filter(|k| k / m / 2 != k % m / 2).for_each(|k| given.r[k] = 0.0);
    let owner = given.channel_sensor.clone();
    let protected = (0..sensors).map(|sensor| sensor % every == 1).collect();
    let settings = SecureSettings::new((vec![1e-3; sensors], 1e-4), protected, &owner, vec![1.0; m]).unwrap();
    let estimator = Secure::new(Model::new(given).unwrap(), Some(&identity(n)), settings).unwrap();
    Design::boxed(estimator, plain_units(m)).unwrap()
}

#[test]
fn a_secure_filter_step_allocates_nothing_in_doubt_or_not() {
    for (n, m) in [(1_usize, 1_usize), (1, 6), (4, 9), (12, 30)] {
        for every in [1, 2, 5] {
            let kernel = secure_filter(n, m, every);
            assert_eq!(allocations_of_steps(kernel.as_ref(), None), 0, "steady ({n}, {m}), 1 in {every}");
            for size in [1e-4, 1.0, 1e4] {
                let prior: Vec<f64> = identity(n).iter().map(|one| size * one).collect();
                let counted = allocations_of_steps(kernel.as_ref(), Some(&prior));
                assert_eq!(counted, 0, "prior {size} ({n}, {m}), 1 in {every}");
            }
        }
    }
}

#[test]
fn a_step_with_attacks_as_states_allocates_nothing_broken_down_or_not() {
    for (n, m) in [(2, 1), (4, 5), (12, 30)] {
        for factor in [None, Some(0.95), Some(1e-30)] {
            let kernel = augmented(n, m, factor);
            assert_eq!(allocations_of_steps(kernel.as_ref(), None), 0, "steady ({n}, {m}) {factor:?}");
            let prior = identity(n - 1);
            let started = allocations_of_steps(kernel.as_ref(), Some(&prior));
            assert_eq!(started, 0, "prior ({n}, {m}) {factor:?}");
        }
    }
}

/// A monitor with a rough gain that names whoever leads by a little, so that biases come, merge and go.
fn bias_monitor(states: usize, channels: usize, limit: f64) -> std::sync::Arc<dyn Kernel> {
    let (n, m) = (states, channels);
    let design = MonitorDesign {
        gain: (0..n * m).map(|i| if i / m == i % m % n { 0.3 / m as f64 } else { 0.0 }).collect(),
        innovation_cov: identity(m),
        covariance: identity(n),
        rule: Statistic { window: 8, kappa: 1.5, gamma: 1.0 },
        law: Law {
            limit,
            margin: 0.0,
            persist: 2,
            further: 0.0,
            uncheckable: (0..m.div_ceil(2)).map(|sensor| sensor == 1).collect(),
        },
        drop: 0.5,
    };
    Design::boxed(BiasMonitor::new(model(n, m), design).unwrap(), plain_units(m)).unwrap()
}

#[test]
fn a_bias_monitor_step_allocates_nothing_whoever_is_named() {
    for (n, m) in [(1, 3), (4, 5), (12, 30)] {
        for limit in [f64::INFINITY, 9.0, 0.1] {
            let kernel = bias_monitor(n, m, limit);
            assert_eq!(allocations_of_steps(kernel.as_ref(), None), 0, "({n}, {m}) {limit}");
        }
    }
}

/// m sensors that all see the same n states, each with an orthonormal block of its own in g.
fn sparse_fusion(states: usize, channels: usize) -> std::sync::Arc<dyn Kernel> {
    let (n, m) = (states, channels);
    let d = n * m;
    let share = 1.0 / m as f64;
    let (mut hessian, mut fusion, mut c) = (identity(d), vec![0.0; n * d], vec![0.0; m * n]);
    for i in 0..d {
        for j in (i % n..d).step_by(n) {
            hessian[i * d + j] -= share;
        }
        fusion[(i % n) * d + i] = share;
    }
    c.iter_mut().enumerate().for_each(|(k, value)| *value = 1.0 / (1.0 + (k % n) as f64));
    let diagonal = |value: f64| identity(n).iter().map(|one| value * one).collect::<Vec<_>>();
    let starts: Vec<usize> = (0..=m).map(|i| i * n).collect();
    let per_channel: Vec<f64> = (0..m * d).map(|k| if (k % d) / n == k / d { 0.5 } else { 0.0 }).collect();
    let blocks = || Blocks::new(starts.clone(), starts.clone(), identity(n).repeat(m)).unwrap();
    let projection = Projection::dense(hessian.iter().map(|v| -v).collect(), blocks()).unwrap();
    let estimator = SparseFusion::new(
        sparse_fusion::Matrices {
            dims: Dims { states: n, channels: m, sensors: m, inputs: 1 },
            a: diagonal(0.9),
            b: vec![0.1; n],
            c: c.clone(),
            d: vec![0.0; m],
            t_transposed: diagonal(0.5),
            drive: vec![0.8; n],
            input_map: vec![0.1; m * n],
            start_map: vec![],
            modes: identity(n),
            a_s: diagonal(0.9),
            b_s: vec![0.1; n],
            c_s: c,
            v_s: identity(n),
            fusion: fusion.clone(),
            fusion_g: fusion,
            hessian,
            groups: starts.clone(),
            sensors: starts.clone(),
            channel_sensor: (0..m).collect(),
            gamma: vec![2.0; m],
            attack_now: per_channel.clone(),
            attack_before: per_channel,
            p: identity(n),
            q: identity(n),
            krk: diagonal(0.1),
            ikc: diagonal(0.5),
            innovation_std: vec![1.0; m],
            suspicion: 3.0,
            refit: (m - 1) / 2,
        },
        projection,
    );
    Design::boxed(estimator.unwrap(), plain_units(m)).unwrap()
}

#[test]
fn a_sparse_fusion_step_allocates_nothing_attacked_or_not() {
    for (n, m) in [(1, 3), (3, 5), (10, 20)] {
        let kernel = sparse_fusion(n, m);
        assert_eq!(allocations_of_steps(kernel.as_ref(), None), 0, "({n}, {m})");
    }
}

/// The channels of every second sensor of `model`, and of each of the others.
fn guarded(channels: usize) -> (Vec<usize>, Vec<Vec<usize>>) {
    let own = (0..channels).filter(|i| (i / 2) % 2 == 1).collect();
    let others = (0..channels.div_ceil(2)).step_by(2);
    (own, others.map(|sensor| (2 * sensor..channels.min(2 * sensor + 2)).collect()).collect())
}

/// The Kalman filter of every second sensor, and the test of the others.
fn protected(states: usize, channels: usize) -> Protected {
    let (n, m, (own, _)) = (states, channels, guarded(channels));
    let whole = matrices(n, m);
    let pick = |rows: &[f64], width: usize| {
        own.iter().flat_map(|&i| rows[i * width..(i + 1) * width].to_vec()).collect::<Vec<f64>>()
    };
    let alone = Matrices {
        c: pick(&whole.c, n),
        d: pick(&whole.d, 1),
        r: own
            .iter()
            .flat_map(|&i| own.iter().map(move |&j| (i, j)))
            .map(|(i, j)| whole.r[i * m + j])
            .collect(),
        channel_sensor: (0..own.len()).map(|i| i / 2).collect(),
        sensors: own.len().div_ceil(2),
        ..matrices(n, 1)
    };
    let filter = Kalman::new(Model::new(alone).unwrap(), Some(&identity(n))).unwrap();
    Protected::new(filter, model(n, m), own, bounds(m)).unwrap()
}

fn bounds(channels: usize) -> Vec<f64> {
    let mut quantiles = vec![6.0; channels + 1];
    quantiles[0] = f64::INFINITY;
    quantiles
}

#[test]
fn a_protected_kalman_step_allocates_nothing() {
    for (n, m) in [(1, 3), (4, 5), (12, 30)] {
        let kernel = Design::boxed(protected(n, m), plain_units(m)).unwrap();
        assert_eq!(allocations_of_steps(kernel.as_ref(), None), 0, "steady ({n}, {m})");
        let prior = identity(n);
        assert_eq!(allocations_of_steps(kernel.as_ref(), Some(&prior)), 0, "prior ({n}, {m})");
    }
}

/// A kernel, and whether it has a steady state.
fn joint_fusion(
    (n, m): (usize, usize),
    form: Form,
    rule: Fusion,
    choice: Choice,
) -> (std::sync::Arc<dyn Kernel>, bool) {
    let (own, others) = guarded(m);
    let stacks: Vec<_> = others.into_iter().map(|weak| (weak, own.clone())).collect();
    let model = model(n, m);
    let layout = Stacks::new(n, &model.channel_sensor, &stacks).unwrap();
    let eta = vec![0.5; layout.weak];
    let design = Recursions::new(model, layout, form, rule);
    let estimator =
        JointFusion::new(design, (eta, choice), Some(protected(n, m)), Some(&identity(n))).unwrap();
    let steady = estimator.is_steady();
    (Design::boxed(estimator, plain_units(m)).unwrap(), steady)
}

#[test]
fn a_joint_fusion_step_allocates_nothing_in_any_form() {
    for (n, m) in [(1, 3), (4, 5), (5, 11)] {
        let filter = Kalman::new(model(n, m), Some(&identity(n))).unwrap();
        let detector = Box::new(Detector::new(filter, Rule::Gate, bounds(m)).unwrap());
        let auto = Choice::Auto { detector, marked: vec![false; m.div_ceil(2)] };
        let adaptive = Choice::Adaptive { window: 5, gate: 9.0 };
        for (form, rule, choice) in [
            (Form::Exact, Fusion::Optimal, Choice::Fixed),
            (Form::SquareRoot, Fusion::Optimal, Choice::Fixed),
            (Form::Printed, Fusion::Optimal, Choice::Fixed),
            (Form::Exact, Fusion::Average, Choice::Fixed),
            (Form::Exact, Fusion::CovarianceIntersection, Choice::Fixed),
            (Form::Exact, Fusion::Optimal, adaptive.clone()),
            (Form::SquareRoot, Fusion::Optimal, adaptive),
            (Form::Exact, Fusion::Optimal, auto.clone()),
            (Form::SquareRoot, Fusion::Optimal, auto),
        ] {
            let name = format!("({n}, {m}) {form:?} {rule:?} {choice:?}");
            let (kernel, steady) = joint_fusion((n, m), form, rule, choice);
            assert!(steady || form == Form::Printed, "{name}");
            if steady {
                assert_eq!(allocations_of_steps(kernel.as_ref(), None), 0, "steady {name}");
            }
            assert_eq!(allocations_of_steps(kernel.as_ref(), Some(&identity(n))), 0, "prior {name}");
        }
    }
}
