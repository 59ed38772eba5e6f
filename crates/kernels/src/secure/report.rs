//! What one sample says of every sensor.

use crate::Output;
use crate::estimator::Status;
use crate::kalman::gains::innovation_deviations;
use crate::kalman::heard::Heard;
use crate::kalman::ud::Ud;
use crate::mixture::sample::Sample;
use crate::secure::labels::Labels;
use crate::secure::memory::Memory;
use crate::secure::settings::Settings;
use crate::secure::{Secure, Work};

/// Variance of an innovation over that of its noise beyond which rounding of the information form counts.
const WIDEST: f64 = 1e13;

/// Deviations by which beliefs must disagree on a state to be called ambiguous, and the weight from which on.
const APART: (f64, f64) = (1.0, 0.05);

/// Change of beliefs at the cap that is worth a status.
const LOOSE: f64 = 0.05;

impl Secure {
    /// Everything but the injections.
    #[inline(always)]
    pub(super) fn report(&self, work: &mut Work, out: &mut Output<'_>) {
        let n = self.model.dims.states;
        let Work { candidates, kept, sample, trust, next, .. } = work;
        let arrived = sample.arrived.len();
        let Some(&first) = kept.first() else {
            return;
        };
        let top = candidates[first].weight;
        let sum: f64 = kept.iter().map(|&i| (candidates[i].weight - top).exp()).sum();
        let share = |i: usize| (candidates[i].weight - top).exp() / sum;
        out.x.fill(0.0);
        trust.fill(0.0);
        for &i in kept.iter() {
            let weight = share(i);
            out.x.iter_mut().zip(&candidates[i].x).for_each(|(x, own)| *x += weight * own);
            for (trust, honest) in trust[..arrived].iter_mut().zip(&candidates[i].labels.honest) {
                *trust += weight * honest;
            }
        }
        out.x_std.fill(0.0);
        let mut apart = 0.0_f64;
        let mut rival = 0.0_f64;
        if let Some(p) = out.covariance.as_deref_mut() {
            p.fill(0.0);
        }
        for &i in kept.iter() {
            let (weight, one) = (share(i), &candidates[i]);
            for (a, target) in next.iter_mut().enumerate() {
                *target = one.x[a] - out.x[a];
            }
            for row in one.root.chunks_exact(n).chain(std::iter::once(&next[..])) {
                for (a, std) in out.x_std.iter_mut().enumerate() {
                    *std += weight * row[a] * row[a];
                    if let Some(p) = out.covariance.as_deref_mut() {
                        for b in 0..n {
                            p[a * n + b] += weight * row[a] * row[b];
                        }
                    }
                }
            }
            if i != first {
                rival = rival.max(weight);
                if weight >= APART.1 {
                    for a in 0..n {
                        let main = &candidates[first];
                        let variance: f64 = main.root.chunks_exact(n).map(|row| row[a] * row[a]).sum();
                        apart = apart.max((one.x[a] - main.x[a]).abs() / variance.sqrt().max(f64::MIN_POSITIVE));
                    }
                }
            }
        }
        out.x_std.iter_mut().for_each(|variance| *variance = variance.sqrt());
        out.trust.fill(f64::NAN);
        out.suspected.fill(0);
        let mut distrusted = 0;
        for (one, &gamma) in sample.arrived.iter().zip(trust.iter()) {
            out.trust[one.sensor] = gamma.clamp(0.0, 1.0);
            if gamma < 0.5 {
                out.suspected[one.sensor] = 1;
                distrusted += 1;
            }
        }
        for (value, innovation) in out.attack.iter_mut().zip(out.innovation.iter()) {
            *value = if innovation.is_nan() { f64::NAN } else { 0.0 };
        }
        out.attack_std.fill(f64::NAN);
        let labels = &candidates[first].labels;
        let numbers = [
            work.information.count() as f64,
            labels.sweeps as f64,
            labels.gap,
            distrusted as f64,
            rival,
            kept.len() as f64,
            0.0,
            0.0,
        ];
        out.diagnostics.copy_from_slice(&numbers);
        let finite = out.x_std.iter().all(|deviation| deviation.is_finite());
        let wide = sample.variance[..work.information.count()].iter().any(|&variance| variance > WIDEST);
        *out.status = match () {
            () if !finite || wide => Status::IllConditioned,
            () if arrived == 0 => Status::NoMeasurement,
            () if distrusted > self.settings.most(sample) => Status::MajoritySuspect,
            () if apart > APART.0 => Status::Ambiguous,
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

impl Memory {
    /// What every distrusted sensor injects: what is remembered of a steady lie, else what it sent less what the others
    /// expect.
    #[inline(always)]
    pub(super) fn report(
        &self,
        settings: &Settings,
        heard: &Heard,
        sample: &Sample,
        labels: &Labels,
        trust: &[f64],
        out: &mut Output<'_>,
    ) {
        for (index, one) in sample.arrived.iter().enumerate() {
            if trust[index] >= 0.5 {
                continue;
            }
            let (value, variance) = self.injection(one.sensor, labels.label(index));
            for a in 0..one.size {
                let channel = heard.channels()[one.first + a];
                let deviation = settings.deviations[channel];
                let value = value[channel];
                out.attack[channel] = value;
                out.attack_std[channel] = deviation * variance.sqrt();
            }
        }
    }
}
