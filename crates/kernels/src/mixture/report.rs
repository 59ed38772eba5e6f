//! What one sample says of every sensor: belief, injection, drift.

use crate::Output;
use crate::estimator::Status;
use crate::kalman::gains::innovation_deviations;
use crate::kalman::ud::Ud;
use crate::mixture::information::Information;
use crate::mixture::labels::{Labels, Scratch};
use crate::mixture::memory::Past;
use crate::mixture::sample::{Arrived, Sample};
use crate::mixture::{LOOSE, Mixture, Verdict, Work};

/// Standardised residuals count as no more than this in the monitor.
const CLIP: f64 = 4.0;

/// Variance of an innovation over that of its noise beyond which rounding of the information form counts.
const WIDEST: f64 = 1e13;

/// Least doubt and least belief of a sensor that is undecided.
const UNDECIDED: f64 = 1.0 / 3.0;

impl Mixture {
    /// Average what the others do not expect of every sensor, and withdraw belief where that is too far from nothing;
    /// returns whether it did.
    #[inline(always)]
    pub(super) fn monitor(&self, past: &mut Past, work: &mut Work, winner: usize) -> bool {
        let Some(forgetting) = self.settings.monitor else { return false };
        self.leave_out(work, winner);
        let Work { heard, sample, information, scratch, starts, excess, .. } = work;
        let labels = &mut starts[winner];
        let gain = (1.0 + forgetting) / (1.0 - forgetting);
        for (index, one) in sample.arrived.iter().enumerate() {
            standardise(labels, one, sample, information, scratch);
            let mut square = 0.0;
            let channels = &heard.channels()[one.first..one.first + one.size];
            for (&channel, residual) in channels.iter().zip(&scratch.block.scaled) {
                let drift = &mut past.drift[channel];
                *drift = forgetting * *drift + (1.0 - forgetting) * residual.clamp(-CLIP, CLIP);
                square += gain * *drift * *drift;
            }
            excess[index] = if one.protected { 0.0 } else { square / self.settings.quantiles[one.size] };
        }
        let mut accused = false;
        for _ in 0..(sample.arrived.len().saturating_sub(1)) / 2 {
            let found = (0..sample.arrived.len()).fold(0, |a, b| if excess[b] > excess[a] { b } else { a });
            if excess[found] <= 1.0 {
                break;
            }
            excess[found] = 0.0;
            accused = true;
            labels.disbelieve(sample, found);
        }
        accused
    }

    /// W for the winner's sites.
    #[inline(always)]
    fn leave_out(&self, work: &mut Work, winner: usize) {
        let Work { sample, information, scratch, starts, .. } = work;
        let count = information.count();
        starts[winner].weigh(sample, information, &mut scratch.block);
        information.update();
        let (shift, variance) = (&mut scratch.shift[..count], &mut scratch.variance[..count]);
        information.expect(&starts[winner].eta[..count], shift, variance);
    }

    /// Everything there is to report. `x` is x[k|k], `prior` still P[k|k−1].
    #[inline(always)]
    pub(super) fn report(
        &self,
        work: &mut Work,
        (k, x, prior): (usize, &[f64], &Ud),
        verdict: &Verdict,
        out: &mut Output<'_>,
    ) {
        out.x.copy_from_slice(x);
        work.posterior.report(out.x_std, out.covariance.as_deref_mut());
        out.innovation.copy_from_slice(&work.innovation);
        self.innovation_std(work, k, prior, out.innovation_std);
        out.trust.fill(f64::NAN);
        out.suspected.fill(0);
        let mut distrusted = 0;
        for (value, innovation) in out.attack.iter_mut().zip(out.innovation.iter()) {
            *value = if innovation.is_nan() { f64::NAN } else { 0.0 };
        }
        out.attack_std.fill(f64::NAN);
        for (one, &gamma) in work.sample.arrived.iter().zip(&work.gamma) {
            out.trust[one.sensor] = gamma;
            if gamma < 0.5 {
                out.suspected[one.sensor] = 1;
                distrusted += 1;
            }
        }
        if distrusted > 0 {
            self.estimate_attacks(work, verdict.winner, out);
        }
        let arrived = work.sample.arrived.len();
        let labels = &work.starts[verdict.winner];
        let numbers = [
            work.information.count() as f64,
            labels.sweeps as f64,
            labels.gap,
            distrusted as f64,
            verdict.rival,
        ];
        out.diagnostics.copy_from_slice(&numbers);
        let finite = out.x_std.iter().all(|deviation| deviation.is_finite());
        let wide = work.sample.variance[..work.information.count()].iter().any(|&variance| variance > WIDEST);
        let between = |&&gamma: &&f64| gamma > UNDECIDED && gamma < 1.0 - UNDECIDED;
        let undecided = work.gamma[..arrived].iter().filter(between).count();
        *out.status = match () {
            () if !finite || wide => Status::IllConditioned,
            () if arrived == 0 => Status::NoMeasurement,
            () if 2 * distrusted > arrived => Status::MajoritySuspect,
            () if verdict.ambiguous || (undecided > 1 && 2 * undecided >= arrived) => Status::Ambiguous,
            () if labels.gap > LOOSE => Status::NotConverged,
            () => Status::Ok,
        } as u8;
    }

    #[inline(always)]
    fn innovation_std(&self, work: &mut Work, k: usize, prior: &Ud, out: &mut [f64]) {
        let m = out.len();
        if work.sample.widest > 1 || work.information.count() < m {
            innovation_deviations(&self.model, k, prior, &mut work.channel[..m], out);
            return;
        }
        for (i, (target, variance)) in out.iter_mut().zip(&work.sample.variance).enumerate() {
            *target = (self.noise.r[i * m + i] * variance).sqrt();
        }
    }

    /// What every distrusted sensor sent, less what the others expect of it.
    #[inline(always)]
    fn estimate_attacks(&self, work: &mut Work, winner: usize, out: &mut Output<'_>) {
        self.leave_out(work, winner);
        let Work { heard, sample, information, scratch, starts, innovation, gamma, .. } = work;
        for (one, &gamma) in sample.arrived.iter().zip(&*gamma) {
            if gamma >= 0.5 {
                continue;
            }
            let row = |a: usize| heard.whitening().row(one.first + a);
            let place = |a: usize| heard.channels()[one.first + a];
            if one.size == 1 {
                let (mean, h) = starts[winner].others(one, scratch);
                let scale = row(0).last().copied().unwrap_or(1.0);
                out.attack[place(0)] = innovation[place(0)] - scale * mean;
                out.attack_std[place(0)] = scale * (h + 1.0).sqrt();
                continue;
            }
            starts[winner].others_jointly(one, sample, information, scratch);
            let (size, block) = (one.size, &scratch.block);
            for a in 0..size {
                let row = row(a); // L_a, from channel `from` of the sensor to a
                let from = a + 1 - row.len();
                let known: f64 = row.iter().zip(&block.mean[from..]).map(|(l, mean)| l * mean).sum();
                out.attack[place(a)] = innovation[place(a)] - known;
                let mut variance = 0.0;
                for (b, left) in row.iter().enumerate() {
                    for (c, right) in row.iter().enumerate() {
                        let unit = f64::from(u8::from(b == c));
                        variance += left * right * (block.h[(from + b) * size + from + c] + unit);
                    }
                }
                out.attack_std[place(a)] = variance.sqrt();
            }
        }
    }
}

/// L_V⁻¹ ρ of one sensor, left in `scratch.block.scaled`.
fn standardise(
    labels: &Labels,
    one: &Arrived,
    sample: &Sample,
    information: &Information,
    scratch: &mut Scratch,
) {
    if one.size == 1 {
        let (mean, h) = labels.others(one, scratch);
        scratch.block.scaled[0] = (sample.residual[one.first] - mean) / (h + 1.0).sqrt();
        return;
    }
    labels.others_jointly(one, sample, information, scratch);
    scratch.block.standardise(one.size);
}
