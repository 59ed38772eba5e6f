//! Sparse fusion: one local filter per channel, fused by a (group) LASSO.
//!
//! References: Liu, Mo, Garone 2020, equations (12), (19), (31). The design (all matrices) is made in Python;
//! `securestate/estimators/sparse_fusion.py` says where and why it differs from the paper.

use crate::codec::{Decoder, Encoder, Fingerprint};
use crate::estimator::{Dims, Estimator, Output, Status};
use crate::linalg::{add_gemv_transposed, axpy, cholesky, dot, forward_solve, gemv};
use crate::penalty::{Outcome, Problem, SOLVED};
use crate::projection::Projection;
use crate::{Error, Result, group_lasso, lasso};

/// A pivot of the accused sensors' information below this share means the others do not determine the state.
const UNDETERMINED: f64 = 1e-9;
/// The covariance counts as steady again when it is this close, relative to its largest entry.
const STEADY: f64 = 1e-10;

/// Everything computed at design time. Matrices are row-major; d elements of g in all, n_u flat and n_s other modes.
#[derive(Debug, Clone)]
pub struct Matrices {
    /// Sizes.
    pub dims: Dims,
    /// Plant: A (n, n), B (n, p), C (m, n), D (m, p).
    pub a: Vec<f64>,
    #[allow(missing_docs)]
    pub b: Vec<f64>,
    #[allow(missing_docs)]
    pub c: Vec<f64>,
    #[allow(missing_docs)]
    pub d: Vec<f64>,
    /// Local filters: T transposed (n, n) and b (n,) of (12).
    pub t_transposed: Vec<f64>,
    #[allow(missing_docs)]
    pub drive: Vec<f64>,
    /// Effect of the known input on the local filters, (m n, p).
    pub input_map: Vec<f64>,
    /// Local filters from the flat modes of the prior mean, (m n, n_u).
    pub start_map: Vec<f64>,
    /// V⁻¹ (n, n): flat modes first.
    pub modes: Vec<f64>,
    /// The other modes, driven by the known input alone: A_s (n_s, n_s), B_s (n_s, p), C V_s (m, n_s), V_s (n, n_s).
    pub a_s: Vec<f64>,
    #[allow(missing_docs)]
    pub b_s: Vec<f64>,
    #[allow(missing_docs)]
    pub c_s: Vec<f64>,
    #[allow(missing_docs)]
    pub v_s: Vec<f64>,
    /// Kalman fusion F (n, m n) of (11) and its effect on g, F S (n, d).
    pub fusion: Vec<f64>,
    #[allow(missing_docs)]
    pub fusion_g: Vec<f64>,
    /// H = Sᵀ N S (d, d).
    pub hessian: Vec<f64>,
    /// First element of every penalty group and of every sensor, and d at the end.
    pub groups: Vec<usize>,
    #[allow(missing_docs)]
    pub sensors: Vec<usize>,
    /// Owner of every channel.
    pub channel_sensor: Vec<usize>,
    /// γ per penalty group.
    pub gamma: Vec<f64>,
    /// Attack estimate per channel from its sensor's g(k) and g(k−1): (m, d) each, zero outside the sensor.
    pub attack_now: Vec<f64>,
    #[allow(missing_docs)]
    pub attack_before: Vec<f64>,
    /// Steady posterior covariance P (n, n), noise Q (n, n), K R Kᵀ (n, n), I − K C (n, n), √diag S (m,).
    pub p: Vec<f64>,
    #[allow(missing_docs)]
    pub q: Vec<f64>,
    #[allow(missing_docs)]
    pub krk: Vec<f64>,
    #[allow(missing_docs)]
    pub ikc: Vec<f64>,
    #[allow(missing_docs)]
    pub innovation_std: Vec<f64>,
    /// A sensor whose ‖f_i‖ in the metric N_ii exceeds this is suspected.
    pub suspicion: f64,
    /// How many suspected sensors may be freed of their penalty (refit); 0 = none.
    pub refit: usize,
}

/// The estimator.
#[derive(Debug, Clone)]
pub struct SparseFusion {
    m: Matrices,
    projection: Projection,
    element_wise: bool,
    flat: usize,
}

/// Local filters, predictions and warm start.
#[derive(Debug, Clone)]
pub struct State {
    /// ζ before the correction with y, (m, n).
    zeta: Vec<f64>,
    /// Part of the non-flat modes that the known input and the prior explain, (n_s,).
    x_s: Vec<f64>,
    /// A x + B u, (n,).
    predicted: Vec<f64>,
    /// Solution of this and of the last step, (d,).
    g: Vec<f64>,
    g_before: Vec<f64>,
    /// P while it is not steady.
    p: Vec<f64>,
    transient: bool,
    scratch: Scratch,
}

#[derive(Debug, Clone)]
struct Scratch {
    nu: Vec<f64>,
    gamma: Vec<f64>,
    zeta: Vec<f64>,
    x_s: Vec<f64>,
    projection: Vec<f64>,
    square: Vec<f64>,
    square_2: Vec<f64>,
    factor: Vec<f64>,
    half: Vec<f64>,
    support: Vec<usize>,
    missing: Vec<bool>,
    solver: Solver,
}

#[derive(Debug, Clone)]
enum Solver {
    Elements(lasso::Workspace),
    Groups(group_lasso::Workspace),
}

impl SparseFusion {
    /// Check the sizes and make the estimator.
    ///
    /// # Errors
    /// The name of the first matrix whose size does not fit.
    pub fn new(m: Matrices, projection: Projection) -> Result<Self> {
        let Dims {
            states: n,
            channels,
            inputs: p,
            sensors,
        } = m.dims;
        let d = m.groups.last().copied().unwrap_or(0);
        let others = m.c_s.len().checked_div(channels).unwrap_or(0);
        let local = channels * n;
        let sizes: [(&'static str, usize, usize); 22] = [
            ("a", n * n, m.a.len()),
            ("b", n * p, m.b.len()),
            ("c", channels * n, m.c.len()),
            ("d", channels * p, m.d.len()),
            ("t_transposed", n * n, m.t_transposed.len()),
            ("drive", n, m.drive.len()),
            ("input_map", local * p, m.input_map.len()),
            ("start_map", local * (n - others.min(n)), m.start_map.len()),
            ("modes", n * n, m.modes.len()),
            ("a_s", others * others, m.a_s.len()),
            ("b_s", others * p, m.b_s.len()),
            ("v_s", n * others, m.v_s.len()),
            ("fusion", n * local, m.fusion.len()),
            ("fusion_g", n * d, m.fusion_g.len()),
            ("hessian", d * d, m.hessian.len()),
            ("gamma", m.groups.len().saturating_sub(1), m.gamma.len()),
            ("sensors", sensors + 1, m.sensors.len()),
            ("channel_sensor", channels, m.channel_sensor.len()),
            ("attack_now", channels * d, m.attack_now.len()),
            ("attack_before", channels * d, m.attack_before.len()),
            ("p", n * n, m.p.len()),
            ("innovation_std", channels, m.innovation_std.len()),
        ];
        for (name, expected, received) in sizes {
            Error::check_len(name, expected, received)?;
        }
        let element_wise = m.groups.windows(2).all(|pair| pair[1] - pair[0] == 1);
        Ok(Self {
            flat: n - others,
            m,
            projection,
            element_wise,
        })
    }

    /// d, elements of g.
    fn elements(&self) -> usize {
        self.m.fusion_g.len() / self.m.dims.states
    }

    fn scratch(&self) -> Scratch {
        let (n, d) = (self.m.dims.states, self.elements());
        let reserved = d.min(400);
        Scratch {
            nu: vec![0.0; d],
            gamma: self.m.gamma.clone(),
            zeta: vec![0.0; self.m.dims.channels * n],
            x_s: vec![0.0; n - self.flat],
            projection: self.projection.scratch(),
            square: vec![0.0; n * n],
            square_2: vec![0.0; n * n],
            factor: vec![0.0; reserved * reserved],
            half: vec![0.0; reserved * n],
            support: Vec::with_capacity(d),
            missing: vec![false; self.m.dims.channels],
            solver: if self.element_wise {
                Solver::Elements(lasso::Workspace::new(d))
            } else {
                Solver::Groups(group_lasso::Workspace::new(d, self.m.gamma.len()))
            },
        }
    }

    /// Correct the local filters with y (12); a missing channel is filled with its prediction. Returns how many came.
    fn correct(&self, state: &mut State, y: &[f64], u: &[f64], out: &mut Output<'_>) -> usize {
        let m = &self.m;
        let (n, p, others) = (m.dims.states, m.dims.inputs, state.x_s.len());
        let mut arrived = 0;
        for i in 0..m.dims.channels {
            let through = dot(&m.d[i * p..(i + 1) * p], u);
            let expected = dot(&m.c[i * n..(i + 1) * n], &state.predicted) + through;
            let missing = y[i].is_nan();
            state.scratch.missing[i] = missing;
            out.innovation[i] = y[i] - expected;
            out.innovation_std[i] = m.innovation_std[i];
            let value = if missing { expected } else { y[i] };
            let explained = dot(&m.c_s[i * others..(i + 1) * others], &state.x_s);
            axpy(
                value - through - explained,
                &m.drive,
                &mut state.zeta[i * n..(i + 1) * n],
            );
            arrived += usize::from(!missing);
        }
        arrived
    }

    /// Problem (31) in the coordinates g: fast path, solve, refit. `state.g` out.
    fn fuse(&self, state: &mut State) -> (Outcome, bool) {
        let m = &self.m;
        let scratch = &mut state.scratch;
        self.projection
            .apply(&state.zeta, &mut scratch.nu, &mut scratch.projection);
        scratch.gamma.copy_from_slice(&m.gamma);
        let mut freed = false;
        for (i, &sensor) in m.channel_sensor.iter().enumerate() {
            if scratch.missing[i] {
                free(&mut scratch.gamma, &m.groups, m.sensors[sensor], m.sensors[sensor + 1]);
                freed = true;
            }
        }
        let mut problem = Problem {
            hessian: &m.hessian,
            linear: &scratch.nu,
            starts: &m.groups,
            gamma: &scratch.gamma,
            energy: 0.0,
        };
        if !freed && problem.zero_is_optimal() {
            state.g.fill(0.0);
            return (Outcome { iterations: 0, gap: 0.0 }, true);
        }
        problem.energy = self
            .projection
            .energy(&state.zeta, &scratch.nu, &mut scratch.projection);
        let energy = problem.energy;
        let mut total = 0;
        loop {
            let problem = Problem {
                hessian: &m.hessian,
                linear: &scratch.nu,
                starts: &m.groups,
                gamma: &scratch.gamma,
                energy,
            };
            let outcome = match &mut scratch.solver {
                Solver::Elements(ws) => lasso::solve(&problem, &mut state.g, ws),
                Solver::Groups(ws) => group_lasso::solve(&problem, &mut state.g, ws),
            };
            total += outcome.iterations;
            match self.next_to_free(&state.g, &scratch.gamma) {
                Some(sensor) => {
                    free(&mut scratch.gamma, &m.groups, m.sensors[sensor], m.sensors[sensor + 1]);
                }
                None => {
                    return (Outcome { iterations: total, gap: outcome.gap }, false);
                }
            }
        }
    }

    /// The refit: the penalised sensor with the largest ‖f_i‖, if it is suspected and seats are left.
    fn next_to_free(&self, g: &[f64], gamma: &[f64]) -> Option<usize> {
        let m = &self.m;
        let mut freed = 0;
        let mut best = None;
        let mut best_size = m.suspicion;
        for sensor in 0..m.dims.sensors {
            let range = m.sensors[sensor]..m.sensors[sensor + 1];
            if range.is_empty() || is_free(gamma, &m.groups, range.start) {
                freed += usize::from(!range.is_empty());
                continue;
            }
            let size = self.size(g, sensor);
            if size > best_size {
                best_size = size;
                best = Some(sensor);
            }
        }
        best.filter(|_| freed < m.refit)
    }

    /// ‖f_i‖ in the metric N_ii.
    fn size(&self, g: &[f64], sensor: usize) -> f64 {
        let d = self.elements();
        let range = self.m.sensors[sensor]..self.m.sensors[sensor + 1];
        let part = &g[range.clone()];
        if part.iter().all(|&v| v == 0.0) {
            return 0.0;
        }
        let square: f64 = range
            .clone()
            .zip(part)
            .map(|(i, &v)| v * dot(&self.m.hessian[i * d..][range.clone()], part))
            .sum();
        square.max(0.0).sqrt()
    }

    /// P, or P + F_S H_SS⁻¹ F_Sᵀ when the elements S are in use: what is left without them. False if undetermined.
    fn covariance(&self, state: &mut State, out: &mut Output<'_>) -> bool {
        let (n, d) = (self.m.dims.states, self.elements());
        let scratch = &mut state.scratch;
        scratch.square.copy_from_slice(if state.transient { &state.p } else { &self.m.p });
        scratch.support.clear();
        scratch
            .support
            .extend((0..d).filter(|&i| state.g[i] != 0.0));
        let k = scratch.support.len();
        let mut determined = true;
        if k > 0 {
            if scratch.factor.len() < k * k {
                scratch.factor.resize(k * k, 0.0);
                scratch.half.resize(k * n, 0.0);
            }
            for (row, &i) in scratch.support.iter().enumerate() {
                for (column, &j) in scratch.support[..=row].iter().enumerate() {
                    scratch.factor[row * k + column] = self.m.hessian[i * d + j];
                }
            }
            determined = cholesky(&mut scratch.factor, k, k, UNDETERMINED).is_ok();
            if determined {
                self.add_uncertainty(scratch, k);
            } else {
                scratch.square.fill(f64::INFINITY);
            }
        }
        for (i, std) in out.x_std.iter_mut().enumerate() {
            *std = scratch.square[i * n + i].max(0.0).sqrt();
        }
        if let Some(target) = out.covariance.as_deref_mut() {
            target.copy_from_slice(&scratch.square);
        }
        determined
    }

    /// square += (L⁻¹ F_Sᵀ)ᵀ (L⁻¹ F_Sᵀ)
    fn add_uncertainty(&self, scratch: &mut Scratch, k: usize) {
        let (n, d) = (self.m.dims.states, self.elements());
        for a in 0..n {
            let row = &mut scratch.half[a * k..(a + 1) * k];
            for (value, &j) in row.iter_mut().zip(&scratch.support) {
                *value = self.m.fusion_g[a * d + j];
            }
            forward_solve(&scratch.factor, k, row);
        }
        for a in 0..n {
            for c in 0..=a {
                let extra = dot(
                    &scratch.half[a * k..(a + 1) * k],
                    &scratch.half[c * k..(c + 1) * k],
                );
                scratch.square[a * n + c] += extra;
                if a != c {
                    scratch.square[c * n + a] += extra;
                }
            }
        }
    }

    /// True covariance of the fixed-gain filter after samples without any measurement.
    fn track_covariance(&self, state: &mut State, arrived: bool) {
        if arrived && !state.transient {
            return;
        }
        let m = &self.m;
        let n = m.dims.states;
        let (square, square_2) = (&mut state.scratch.square, &mut state.scratch.square_2);
        if !state.transient {
            state.p.copy_from_slice(&m.p);
        }
        congruence(&m.a, &state.p, square, square_2, n);
        add(square_2, &m.q);
        if arrived {
            state.p.copy_from_slice(square_2);
            congruence(&m.ikc, &state.p, square, square_2, n);
            add(square_2, &m.krk);
        }
        state.p.copy_from_slice(square_2);
        let largest = m.p.iter().fold(0.0_f64, |a, v| a.max(v.abs()));
        let distance = m
            .p
            .iter()
            .zip(&state.p)
            .fold(0.0_f64, |a, (p, q)| a.max((p - q).abs()));
        state.transient = distance > STEADY * largest;
    }

    /// Trust 1 / (1 + (‖f_i‖ / suspicion)²), suspicion, and the attack −(bᵀ-weighted) (f_i(k) − T f_i(k−1)).
    fn judge(&self, state: &State, out: &mut Output<'_>) {
        let m = &self.m;
        let d = self.elements();
        for sensor in 0..m.dims.sensors {
            let ratio = self.size(&state.g, sensor) / m.suspicion;
            out.trust[sensor] = 1.0 / (1.0 + ratio * ratio);
            out.suspected[sensor] = u8::from(ratio > 1.0);
        }
        for (i, &sensor) in m.channel_sensor.iter().enumerate() {
            let range = m.sensors[sensor]..m.sensors[sensor + 1];
            out.attack[i] = dot(&m.attack_now[i * d..][range.clone()], &state.g[range.clone()])
                + dot(&m.attack_before[i * d..][range.clone()], &state.g_before[range]);
        }
        for (i, &sensor) in m.channel_sensor.iter().enumerate() {
            if state.scratch.missing[i] {
                out.trust[sensor] = f64::NAN;
                out.suspected[sensor] = 0;
                out.attack[i] = f64::NAN;
            }
        }
    }

    /// ζ ← T ζ + H u, x_s ← A_s x_s + B_s u, prediction A x + B u.
    fn predict(&self, state: &mut State, x: &[f64], u: &[f64]) {
        let m = &self.m;
        let (n, p) = (m.dims.states, m.dims.inputs);
        let scratch = &mut state.scratch;
        for (target, source) in scratch.zeta.chunks_exact_mut(n).zip(state.zeta.chunks_exact(n)) {
            target.fill(0.0);
            add_gemv_transposed(&m.t_transposed, source, target);
        }
        std::mem::swap(&mut scratch.zeta, &mut state.zeta);
        gemv(&m.a, x, &mut state.predicted);
        gemv(&m.a_s, &state.x_s, &mut scratch.x_s);
        std::mem::swap(&mut scratch.x_s, &mut state.x_s);
        if p > 0 {
            add_product(&m.input_map, u, &mut state.zeta);
            add_product(&m.b_s, u, &mut state.x_s);
            add_product(&m.b, u, &mut state.predicted);
        }
    }
}

impl Estimator for SparseFusion {
    type State = State;
    type Plan = ();

    fn dims(&self) -> Dims {
        self.m.dims
    }

    fn diagnostics(&self) -> &'static [&'static str] {
        &["fast_path", "iterations", "gap"]
    }

    fn start(&self, mean: &[f64], covariance: Option<&[f64]>) -> Result<State> {
        let m = &self.m;
        let (n, d) = (m.dims.states, self.elements());
        Error::check_len("prior.x", n, mean.len())?;
        if covariance.is_some() {
            return Err(Error::input(
                "prior.P",
                "None, because sparse fusion runs in steady state",
                "a covariance",
            ));
        }
        let mut modes = vec![0.0; n];
        gemv(&m.modes, mean, &mut modes);
        let mut zeta = vec![0.0; m.dims.channels * n];
        if self.flat > 0 {
            gemv(&m.start_map, &modes[..self.flat], &mut zeta);
        }
        Ok(State {
            zeta,
            x_s: modes[self.flat..].to_vec(),
            predicted: mean.to_vec(),
            g: vec![0.0; d],
            g_before: vec![0.0; d],
            p: m.p.clone(),
            transient: false,
            scratch: self.scratch(),
        })
    }

    fn step(&self, state: &mut State, y: &[f64], u: &[f64], out: &mut Output<'_>) -> Result<()> {
        let arrived = self.correct(state, y, u, out) > 0;
        self.track_covariance(state, arrived);
        state.g_before.copy_from_slice(&state.g);
        let (outcome, fast) = if arrived {
            self.fuse(state)
        } else {
            state.g.fill(0.0);
            (Outcome { iterations: 0, gap: 0.0 }, false)
        };
        if arrived {
            gemv(&self.m.fusion, &state.zeta, out.x);
            add_product(&self.m.v_s, &state.x_s, out.x);
            if !fast {
                add_product(&self.m.fusion_g, &state.g, out.x);
            }
        } else {
            out.x.copy_from_slice(&state.predicted);
        }
        let determined = self.covariance(state, out);
        self.judge(state, out);
        out.diagnostics[0] = f64::from(u8::from(fast));
        out.diagnostics[1] = outcome.iterations as f64;
        out.diagnostics[2] = outcome.gap;
        *out.status = match (arrived, determined, outcome.gap <= SOLVED) {
            (false, _, _) => Status::NoMeasurement,
            (_, false, _) => Status::IllConditioned,
            (_, _, false) => Status::NotConverged,
            _ => Status::Ok,
        } as u8;
        self.predict(state, out.x, u);
        Ok(())
    }

    fn save(&self, state: &State, to: &mut Encoder) {
        to.integer(u64::from(state.transient));
        for part in [
            &state.zeta,
            &state.x_s,
            &state.predicted,
            &state.g,
            &state.g_before,
            &state.p,
        ] {
            to.floats(part);
        }
    }

    fn load(&self, from: &mut Decoder<'_>) -> Result<State> {
        let mut state = self.start(&vec![0.0; self.m.dims.states], None)?;
        state.transient = from.integer()? != 0;
        for part in [
            &mut state.zeta,
            &mut state.x_s,
            &mut state.predicted,
            &mut state.g,
            &mut state.g_before,
            &mut state.p,
        ] {
            from.floats(part)?;
        }
        Ok(state)
    }

    fn fingerprint(&self) -> u64 {
        let m = &self.m;
        [
            &m.a, &m.b, &m.c, &m.d, &m.t_transposed, &m.drive, &m.fusion, &m.hessian, &m.gamma, &m.p,
        ]
        .iter()
        .fold(Fingerprint::default(), |hash, part| hash.floats(part))
        .sizes(&m.groups)
        .sizes(&m.sensors)
        .sizes(&m.channel_sensor)
        .floats(&[m.suspicion, m.refit as f64])
        .finish()
    }
}

/// Free every penalty group among the elements from..to.
fn free(gamma: &mut [f64], groups: &[usize], from: usize, to: usize) {
    for (value, &start) in gamma.iter_mut().zip(groups) {
        if (from..to).contains(&start) {
            *value = 0.0;
        }
    }
}

/// Whether the group that starts at `element` is free.
fn is_free(gamma: &[f64], groups: &[usize], element: usize) -> bool {
    groups
        .binary_search(&element)
        .is_ok_and(|j| gamma[j] == 0.0)
}

/// y += A x, A row-major.
fn add_product(a: &[f64], x: &[f64], y: &mut [f64]) {
    if x.is_empty() {
        return;
    }
    for (row, target) in a.chunks_exact(x.len()).zip(y) {
        *target += dot(row, x);
    }
}

fn add(target: &mut [f64], term: &[f64]) {
    axpy(1.0, term, target);
}

/// result = A P Aᵀ for symmetric P, `half` = A P.
fn congruence(a: &[f64], p: &[f64], half: &mut [f64], result: &mut [f64], n: usize) {
    for i in 0..n {
        gemv(p, &a[i * n..(i + 1) * n], &mut half[i * n..(i + 1) * n]);
    }
    for i in 0..n {
        for j in 0..=i {
            let value = dot(&half[i * n..(i + 1) * n], &a[j * n..(j + 1) * n]);
            result[i * n + j] = value;
            result[j * n + i] = value;
        }
    }
}
