//! Whether the accused are too many to be the liars.
//!
//! In some direction of the state more sensors are accused than believed, the prediction counting as one: the largest
//! eigenvalue of K (I + T)⁻¹ is at least 1, K and T the sums of the unit vectors (in units of P⁻) along which the accused
//! and the others see the state. Among sensors of a scalar state this counts heads; among sensors that each see a part of
//! it, it counts those who see the same part.

use crate::linalg::dot;
use crate::mixture::information::Information;
use crate::secure::Work;
use crate::secure::settings::{Part, Settings};

/// Rounds of the power method.
const ROUNDS: usize = 8;

/// Votes of a protected sensor, as a root.
const PROTECTED: f64 = 1e3;

/// Whether the labelling `winner` accuses more than it believes.
#[inline(always)]
pub(super) fn outvoted(work: &mut Work, settings: &Settings, winner: usize) -> bool {
    let Work { sample, information, trials, direction, .. } = work;
    let labels = &trials[winner];
    let accused = (0..sample.arrived.len()).filter(|&index| !labels.believes(index)).count();
    if accused == 0 || accused > settings.most(sample) {
        return accused > 0;
    }
    if !settings.has(Part::Votes) {
        return false;
    }
    information.clear();
    for (_, one) in sample.arrived.iter().enumerate().filter(|(index, _)| labels.believes(*index)) {
        for channel in one.first..one.first + one.size {
            let factor = if one.protected { PROTECTED } else { unit(information, channel) };
            information.weigh(factor, channel);
        }
    }
    information.update();
    let (v, next) = direction.split_at_mut(information.states());
    v.fill(1.0);
    let mut value = 0.0;
    for _ in 0..ROUNDS {
        let length = dot(v, v).sqrt();
        if length == 0.0 {
            return false;
        }
        v.iter_mut().for_each(|v| *v /= length);
        next.fill(0.0);
        for (_, one) in sample.arrived.iter().enumerate().filter(|(index, _)| !labels.believes(*index)) {
            for channel in one.first..one.first + one.size {
                let factor = unit(information, channel);
                let along: f64 = information.w_t().zip(v.iter()).map(|(w, v)| w[channel] * v).sum();
                for (target, w) in next.iter_mut().zip(information.w_t()) {
                    *target += factor * factor * along * w[channel];
                }
            }
        }
        value = dot(next, next).sqrt();
        v.copy_from_slice(next);
    }
    value >= 1.0
}

/// Inverse length of a row of Z.
#[inline(always)]
fn unit(information: &Information, channel: usize) -> f64 {
    let z = information.z(channel);
    let square = dot(z, z);
    if square > 0.0 { 1.0 / square.sqrt() } else { 0.0 }
}
