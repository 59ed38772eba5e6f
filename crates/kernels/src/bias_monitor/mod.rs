//! Names sensors with a small constant bias by the generalised likelihood ratio on the innovations of the steady Kalman
//! filter, estimates the bias and takes it off the state.
//!
//! # References
//! Willsky, Jones 1976. `securestate/estimators/bias_monitor.py` says what is different here.

pub mod biases;
pub mod effect;
pub mod gaps;
pub mod scan;
pub mod verdict;

use crate::bias_monitor::biases::{Biases, CAPACITY};
use crate::bias_monitor::effect::Steady;
use crate::bias_monitor::gaps::Gaps;
use crate::bias_monitor::scan::{Rule, Scan, Scores};
use crate::bias_monitor::verdict::{Law, Lead, Streak, Verdict, lead};
use crate::codec::{Decoder, Encoder};
use crate::kalman::model::Model;
use crate::{Dims, Error, Estimator, Output, Result, Status};

/// A reading further from its prediction than this many standard deviations is held at that distance.
const SATURATION: f64 = 1e9;

/// The steady filter and all choices.
#[derive(Debug, Clone)]
pub struct Design {
    /// K, x[k|k] = x[k|k−1] + K e, (n, m).
    pub gain: Vec<f64>,
    /// S, (m, m).
    pub innovation_cov: Vec<f64>,
    /// P[k|k], (n, n).
    pub covariance: Vec<f64>,
    /// The statistic.
    pub rule: Rule,
    /// The decision.
    pub law: Law,
    /// b² over its variance below which a bias is dropped.
    pub drop: f64,
}

/// The estimator.
#[derive(Debug, Clone)]
pub struct BiasMonitor {
    steady: Steady,
    scan: Scan,
    design: Design,
}

/// The plain filter, the sums of the scan, the biases, and scratch.
#[derive(Debug, Clone)]
pub struct State {
    /// x[k|k−1] of the filter that believes everybody.
    x: Vec<f64>,
    /// Samples so far, at most the window.
    samples: usize,
    sums: Vec<f64>,
    streak: Streak,
    biases: Biases,
    scratch: Scratch,
}

#[derive(Debug, Clone)]
struct Scratch {
    gaps: Gaps,
    scores: Scores,
    /// Innovation, then ε.
    news: Vec<f64>,
    /// x[k|k] of the plain filter.
    x: Vec<f64>,
    /// Largest evidence per sensor.
    sensors: Vec<f64>,
}

impl BiasMonitor {
    /// Check the sizes and compute the signatures.
    ///
    /// # Errors
    /// A length that does not fit, a setting out of range, or a plant that varies in time.
    pub fn new(model: Model, design: Design) -> Result<Self> {
        let Dims { states: n, channels: m, sensors, .. } = model.dims;
        Error::check_len("covariance", n * n, design.covariance.len())?;
        Error::check_len("uncheckable", sensors, design.law.uncheckable.len())?;
        if design.rule.window == 0 || design.law.persist == 0 {
            return Err(Error::input("window", "at least one sample", "none"));
        }
        if !model.channel_sensor.is_sorted() {
            return Err(Error::input("channel_sensor", "the channels of a sensor side by side", "a mixture"));
        }
        let steady = Steady::new(model, &design.gain, &design.innovation_cov)?;
        let mut scan = Scan::new(design.rule, m);
        let (mut z, mut w, mut s) = (vec![0.0; n], vec![0.0; n], vec![0.0; m]);
        for channel in 0..m {
            z.fill(0.0);
            for age in 0..design.rule.window {
                steady.respond(channel, &z, &mut s);
                w.copy_from_slice(&z);
                steady.correct(&s, &mut w);
                steady.whiten(&mut s);
                scan.put(design.rule, channel, age, &s);
                steady.carry(&w, &mut z);
            }
        }
        Ok(Self { steady, scan, design })
    }

    /// The leader at every sample of whitened innovations (T, m), as a filter that never names anybody sees it.
    pub fn listen(&self, news: &[f64], mut tell: impl FnMut(Lead)) {
        let model = &self.steady.model;
        let (mut sums, mut scores) = (vec![0.0; self.scan.size()], self.scan.scores());
        for (k, news) in news.chunks_exact(model.dims.channels).enumerate() {
            self.scan.advance(news, &mut sums);
            self.scan.score(&sums, k + 1, (&[], &[]), &mut scores);
            tell(lead(&scores.score, &model.channel_sensor));
        }
    }

    /// Leave ε in `state.scratch.news`; x becomes x[k|k]; returns how many channels arrived.
    fn correct(&self, state: &mut State, y: &[f64], u: &[f64], out: &mut Output<'_>) -> usize {
        let State { x, biases, scratch: Scratch { gaps, news, .. }, .. } = state;
        self.steady.model.innovation(0, x, (y, u), news);
        let arrived = gaps.listen(y);
        out.innovation.copy_from_slice(news);
        out.innovation_std.copy_from_slice(&self.steady.std);
        biases.add_to_innovation(&self.steady, out.innovation);
        for (value, std) in news.iter_mut().zip(&self.steady.std).filter(|(value, _)| !value.is_nan()) {
            *value = value.clamp(-SATURATION * std, SATURATION * std);
        }
        gaps.fill(news);
        self.steady.correct(news, x);
        self.steady.whiten(news);
        arrived
    }

    /// Scan what the known biases leave.
    fn score(&self, state: &mut State) -> Lead {
        let State { sums, samples, biases, scratch, .. } = state;
        self.scan.score(sums, *samples, biases.known(), &mut scratch.scores);
        lead(&scratch.scores.score, &self.steady.model.channel_sensor)
    }

    /// Name the leader if it deserves it.
    fn decide(&self, state: &mut State, lead: Lead) -> Verdict {
        let State { sums, streak, biases, scratch, .. } = state;
        let owner = &self.steady.model.channel_sensor;
        let biased = biases.channels().iter().any(|&channel| owner[channel] != lead.sensor);
        let verdict = streak.judge(&self.design.law, lead, biased, biases.count() < CAPACITY);
        if verdict == Verdict::Named {
            let age = scratch.scores.age[lead.channel] as usize;
            biases.add(&self.steady, &self.scan, (lead.channel, age), sums);
            biases.solve(self.design.rule.gamma, self.design.drop);
        }
        verdict
    }

    /// Trust by the odds between "biased" and the alarm level, and what every channel adds.
    fn report(&self, state: &mut State, y: &[f64], out: &mut Output<'_>) {
        let (owner, drop) = (&self.steady.model.channel_sensor, self.design.drop);
        let State { biases, scratch: Scratch { scores, sensors, .. }, .. } = state;
        out.suspected.fill(0);
        out.trust.fill(f64::NAN);
        sensors.fill(f64::NEG_INFINITY);
        for (channel, &sensor) in owner.iter().enumerate() {
            sensors[sensor] = sensors[sensor].max(scores.score[channel]);
        }
        // Σ exp(g / 2), in units of its largest term.
        let limit = self.design.law.limit;
        let top = sensors.iter().fold(limit, |top, &score| top.max(score));
        let sum = sensors.iter().fold(half(limit - top), |sum, &score| sum + half(score - top));
        for (channel, &sensor) in owner.iter().enumerate() {
            (out.attack[channel], out.attack_std[channel]) = (f64::NAN, f64::NAN);
            if y[channel].is_nan() {
                continue;
            }
            out.attack[channel] = 0.0;
            if out.suspected[sensor] == 0 {
                out.trust[sensor] = 1.0 - half(sensors[sensor] - top) / sum;
            }
            let Some((size, variance)) = biases.total(channel) else { continue };
            let strength = size * size / variance;
            if strength >= drop {
                out.attack[channel] = size;
                out.attack_std[channel] = variance.sqrt();
                let before = if out.suspected[sensor] == 0 { 1.0 } else { out.trust[sensor] };
                out.suspected[sensor] = 1;
                out.trust[sensor] = (1.0 / (1.0 + (0.5 * (strength - drop)).exp())).min(before);
            }
        }
    }

    fn report_state(&self, state: &State, out: &mut Output<'_>) {
        let (n, biases) = (self.steady.model.dims.states, &state.biases);
        out.x.copy_from_slice(&state.x);
        biases.subtract_from(out.x);
        for (i, std) in out.x_std.iter_mut().enumerate() {
            *std = (self.design.covariance[i * (n + 1)] + biases.spread(i, i)).sqrt();
        }
        if let Some(target) = out.covariance.as_deref_mut() {
            target.copy_from_slice(&self.design.covariance);
            if biases.count() > 0 {
                for (i, row) in target.chunks_exact_mut(n).enumerate() {
                    row.iter_mut().enumerate().for_each(|(j, value)| *value += biases.spread(i, j));
                }
            }
        }
    }
}

/// exp(x / 2)
fn half(x: f64) -> f64 {
    (0.5 * x).exp()
}

impl Estimator for BiasMonitor {
    type State = State;
    type Plan = ();

    fn dims(&self) -> Dims {
        self.steady.model.dims
    }

    fn diagnostics(&self) -> &'static [&'static str] {
        &["leader", "ratio", "ahead", "biases", "channels"]
    }

    fn start(&self, mean: &[f64], covariance: Option<&[f64]>) -> Result<State> {
        let Dims { states: n, channels: m, sensors, .. } = self.dims();
        Error::check_len("prior.x", n, mean.len())?;
        if covariance.is_some() {
            return Err(Error::input(
                "prior.P",
                "None, because the bias monitor runs in steady state",
                "a covariance",
            ));
        }
        Ok(State {
            x: mean.to_vec(),
            samples: 0,
            sums: vec![0.0; self.scan.size()],
            streak: Streak::default(),
            biases: Biases::new(&self.steady, &self.scan),
            scratch: Scratch {
                gaps: Gaps::new(self.steady.precision.clone(), m),
                scores: self.scan.scores(),
                news: vec![0.0; m],
                x: vec![0.0; n],
                sensors: vec![0.0; sensors],
            },
        })
    }

    fn step(&self, state: &mut State, y: &[f64], u: &[f64], out: &mut Output<'_>) -> Result<()> {
        let (gamma, drop, window) = (self.design.rule.gamma, self.design.drop, self.design.rule.window);
        let arrived = self.correct(state, y, u, out);
        let State { sums, samples, biases, scratch: Scratch { gaps, news, .. }, .. } = state;
        biases.observe(&self.steady, &self.scan, news, |response| gaps.fill(response));
        self.scan.advance(news, sums);
        *samples = window.min(*samples + 1);
        biases.solve(gamma, drop);
        let lead = self.score(state);
        let verdict = self.decide(state, lead);
        state.biases.settle(gamma, drop, window);
        self.report_state(state, out);
        self.report(state, y, out);
        let numbers = [lead.sensor as f64, lead.score, lead.ahead, state.biases.count() as f64];
        out.diagnostics[..4].copy_from_slice(&numbers);
        out.diagnostics[4] = arrived as f64;
        *out.status = match (arrived, verdict) {
            (0, _) => Status::NoMeasurement,
            (_, Verdict::Unclear) => Status::Ambiguous,
            _ => Status::Ok,
        } as u8;
        let State { x, biases, scratch, .. } = state;
        self.steady.model.predict(0, x, u, &mut scratch.x);
        std::mem::swap(x, &mut scratch.x);
        biases.predict(&self.steady);
        Ok(())
    }

    fn save(&self, state: &State, to: &mut Encoder) {
        to.floats(&state.x);
        to.integer(state.samples as u64);
        to.floats(&state.sums);
        to.integer(state.streak.sensor as u64);
        to.integer(state.streak.wins as u64);
        state.biases.save(to);
    }

    fn load(&self, from: &mut Decoder<'_>) -> Result<State> {
        let mut state = self.start(&vec![0.0; self.dims().states], None)?;
        from.floats(&mut state.x)?;
        state.samples = from.integer()? as usize;
        from.floats(&mut state.sums)?;
        state.streak.sensor = from.integer()? as usize;
        state.streak.wins = from.integer()? as usize;
        state.biases.load(from)?;
        Ok(state)
    }

    fn fingerprint(&self) -> u64 {
        let Design { gain, innovation_cov, covariance, rule, law, drop } = &self.design;
        let alone = law.uncheckable.iter().map(|&alone| usize::from(alone)).collect::<Vec<_>>();
        self.steady
            .model
            .fingerprint()
            .floats(gain)
            .floats(innovation_cov)
            .floats(covariance)
            .floats(&[rule.kappa, rule.gamma, law.limit, law.margin, law.further, *drop])
            .sizes(&[rule.window, law.persist])
            .sizes(&alone)
            .finish()
    }
}
