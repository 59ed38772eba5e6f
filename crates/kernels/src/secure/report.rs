//! What one sample says of every sensor.

use crate::Output;
use crate::estimator::Status;
use crate::kalman::gains::innovation_deviations;
use crate::kalman::ud::Ud;
use crate::secure::memory::{Memory, colour};
use crate::secure::{Secure, Verdict, Work};

/// Variance of an innovation over that of its noise beyond which rounding of the information form counts.
const WIDEST: f64 = 1e13;

/// Share of an innovation from which on it was cut before it was judged; less is rounding.
const CUT: f64 = 1e-9;

/// Deviations by which beliefs must disagree on a state to be called ambiguous, and the weight from which on.
const APART: (f64, f64) = (1.0, 0.05);

/// Change of beliefs at the cap that is worth a status.
const LOOSE: f64 = 0.05;

impl Secure {
    /// Everything there is to report. `x` is x[k|k].
    #[inline(always)]
    pub(super) fn report(
        &self,
        work: &mut Work,
        x: &[f64],
        memory: &Memory,
        verdict: &Verdict,
        out: &mut Output<'_>,
    ) {
        out.x.copy_from_slice(x);
        work.posterior.report(out.x_std, out.covariance.as_deref_mut());
        out.innovation.copy_from_slice(&work.innovation);
        out.trust.fill(f64::NAN);
        out.suspected.fill(0);
        for (value, innovation) in out.attack.iter_mut().zip(out.innovation.iter()) {
            *value = if innovation.is_nan() { f64::NAN } else { 0.0 };
        }
        out.attack_std.fill(f64::NAN);
        let Work { heard, sample, information, trials, .. } = work;
        let labels = &trials[verdict.winner];
        let mut distrusted = 0;
        for (index, one) in sample.arrived.iter().enumerate() {
            let trust = labels.belief[index][0];
            out.trust[one.sensor] = trust;
            if trust >= 0.5 {
                continue;
            }
            out.suspected[one.sensor] = 1;
            distrusted += 1;
            let (injection, variance) = memory.injection(one.sensor, labels.label(index));
            for (a, &channel) in heard.channels()[one.first..one.first + one.size].iter().enumerate() {
                let judged = colour(heard, one, a, |b| sample.residual[one.first + b]);
                let cut = out.innovation[channel] - judged;
                let beyond = if cut.abs() > CUT * judged.abs() { cut } else { 0.0 };
                out.attack[channel] = injection[channel] + beyond;
                out.attack_std[channel] = self.settings.deviations[channel] * variance.sqrt();
            }
        }
        let numbers = [
            information.count() as f64,
            labels.sweeps as f64,
            labels.gap,
            f64::from(distrusted),
            verdict.rival.map_or(0.0, |(_, weight)| weight),
        ];
        out.diagnostics.copy_from_slice(&numbers);
        let finite = out.x_std.iter().all(|deviation| deviation.is_finite());
        let wide = sample.variance[..information.count()].iter().any(|&variance| variance > WIDEST);
        let ambiguous = verdict.apart > APART.0 && verdict.rival.is_some_and(|(_, weight)| weight >= APART.1);
        *out.status = match () {
            () if !finite || wide => Status::IllConditioned,
            () if sample.arrived.is_empty() => Status::NoMeasurement,
            () if verdict.outvoted => Status::MajoritySuspect,
            () if ambiguous => Status::Ambiguous,
            () if labels.gap > LOOSE => Status::NotConverged,
            () => Status::Ok,
        } as u8;
    }

    #[inline(always)]
    pub(super) fn innovation_std(&self, work: &mut Work, k: usize, prior: &Ud, out: &mut [f64]) {
        let m = out.len();
        if work.sample.widest > 1 || work.information.count() < m {
            innovation_deviations(&self.model, k, prior, &mut work.channel[..m], out);
            return;
        }
        for (i, (target, variance)) in out.iter_mut().zip(&work.sample.variance).enumerate() {
            *target = (self.noise.r[i * m + i] * variance).sqrt();
        }
    }
}
