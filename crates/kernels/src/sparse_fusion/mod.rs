//! Sparse fusion: one local filter per channel, fused by a (group) LASSO.
//!
//! References: Liu, Mo, Garone 2020, equations (12), (19), (31). The design (all matrices) is made in Python;
//! `securestate/estimators/sparse_fusion.py` says where and why it differs from the paper.

mod design;
mod fusion;
mod uncertainty;

pub use design::Matrices;

use self::fusion::Fusion;
use crate::codec::{Decoder, Encoder, Fingerprint};
use crate::estimator::{Dims, Estimator, Output, Status};
use crate::linalg::{add_gemv, add_gemv_transposed, axpy, dot, gemv};
use crate::penalty::{Outcome, SOLVED};
use crate::projection::Projection;
use crate::{Error, Result, group_lasso, lasso};

/// A reading further from its prediction than this many standard deviations is held at that distance: more would
/// only cost digits.
const SATURATION: f64 = 1e12;

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
    gamma_before: Vec<f64>,
    zeta: Vec<f64>,
    x_s: Vec<f64>,
    projection: Vec<f64>,
    square: Vec<f64>,
    square_2: Vec<f64>,
    factor: Vec<f64>,
    half: Vec<f64>,
    shrinkage: Vec<f64>,
    used: usize,
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
        m.check()?;
        Ok(Self {
            flat: m.dims.states - m.others(),
            element_wise: m.groups.windows(2).all(|pair| pair[1] - pair[0] == 1),
            m,
            projection,
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
            gamma_before: self.m.gamma.clone(),
            zeta: vec![0.0; self.m.dims.channels * n],
            x_s: vec![0.0; n - self.flat],
            projection: self.projection.scratch(),
            square: vec![0.0; n * n],
            square_2: vec![0.0; n * n],
            factor: vec![0.0; reserved * reserved],
            half: vec![0.0; 2 * reserved],
            shrinkage: vec![0.0; n],
            used: 0,
            support: Vec::with_capacity(self.m.gamma.len()),
            missing: vec![false; self.m.dims.channels],
            solver: if self.element_wise {
                Solver::Elements(lasso::Workspace::new(d))
            } else {
                Solver::Groups(group_lasso::Workspace::new(d, self.m.gamma.len()))
            },
        }
    }

    /// Correct the local filters with y (12); a missing channel is filled with its prediction. Returns how many came.
    #[allow(clippy::needless_range_loop)] // i is a row of six arrays
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
            let reach = SATURATION * m.innovation_std[i];
            let value = if missing { expected } else { y[i].clamp(expected - reach, expected + reach) };
            let explained = dot(&m.c_s[i * others..(i + 1) * others], &state.x_s);
            axpy(value - through - explained, &m.drive, &mut state.zeta[i * n..(i + 1) * n]);
            arrived += usize::from(!missing);
        }
        arrived
    }

    /// Trust 1 / (1 + (‖f_i‖ / suspicion)²), suspicion, and the attack −(bᵀ-weighted) (f_i(k) − T f_i(k−1)).
    fn judge(&self, state: &State, out: &mut Output<'_>) {
        let m = &self.m;
        let d = self.elements();
        out.attack_std.fill(f64::NAN);
        for sensor in 0..m.dims.sensors {
            let ratio = self.size(&state.g, sensor) / m.suspicion;
            out.trust[sensor] = 1.0 / (1.0 + ratio * ratio);
            out.suspected[sensor] = u8::from(ratio > 1.0);
        }
        for (i, &sensor) in m.channel_sensor.iter().enumerate() {
            let range = self.elements_of(sensor);
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
            add_gemv(&m.input_map, u, &mut state.zeta);
            add_gemv(&m.b_s, u, &mut state.x_s);
            add_gemv(&m.b, u, &mut state.predicted);
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
        let fusion = if arrived {
            self.fuse(state)
        } else {
            state.g.fill(0.0);
            Fusion { outcome: Outcome::default(), fast: false, determined: true }
        };
        if arrived {
            gemv(&self.m.fusion, &state.zeta, out.x);
            add_gemv(&self.m.v_s, &state.x_s, out.x);
            if !fusion.fast {
                add_gemv(&self.m.fusion_g, &state.g, out.x);
            }
        } else {
            out.x.copy_from_slice(&state.predicted);
        }
        let determined = self.covariance(state, out) && fusion.determined;
        self.judge(state, out);
        out.diagnostics[0] = f64::from(u8::from(fusion.fast));
        out.diagnostics[1] = fusion.outcome.iterations as f64;
        out.diagnostics[2] = fusion.outcome.gap;
        *out.status = match (arrived, determined, fusion.outcome.gap <= SOLVED) {
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
        for part in [&state.zeta, &state.x_s, &state.predicted, &state.g, &state.g_before, &state.p] {
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
        [&m.a, &m.b, &m.c, &m.d, &m.t_transposed, &m.drive, &m.fusion, &m.hessian, &m.gamma, &m.p]
            .iter()
            .fold(Fingerprint::default(), |hash, part| hash.floats(part))
            .sizes(&m.groups)
            .sizes(&m.sensors)
            .sizes(&m.channel_sensor)
            .floats(&[m.suspicion, m.refit as f64])
            .finish()
    }
}
