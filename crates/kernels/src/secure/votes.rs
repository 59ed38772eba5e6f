//! Whether the accused are too many to be the liars.
//!
//! They are if they are no minority; a sensor alone with what it sees is not counted, because nobody speaks against it but
//! the prediction. They also are if, of the sensors that see the state along the same line, more are accused
//! than all that are believed see of that line, the prediction counting as one:
//!
//! ```text
//!     k zᵀ (I + T)⁻¹ z > 1
//! ```
//!
//! z is the unit vector (in units of P⁻) along which k accused sensors see the state, T the sum of z zᵀ over the channels
//! of those who are believed. Sensors that see different combinations of states are not counted together: few believed
//! ones may know more than many accused.

use crate::linalg::dot;
use crate::mixture::information::Information;
use crate::mixture::sample::{Arrived, Sample};
use crate::secure::Work;
use crate::secure::labels::Labels;
use crate::secure::settings::{Part, Settings};

/// Cosine from which on two sensors see the same.
const SAME: f64 = 1.0 - 1e-6;

/// Rounding by which as many accused as believed may look like more.
const ROUNDING: f64 = 1e-9;

/// Accused sensors that see the same from which on they may be too many: two may be two liars.
const FEW: usize = 3;

/// Votes of a protected sensor, as a root.
const PROTECTED: f64 = 1e3;

/// Whether the labelling `winner` accuses more than it believes.
#[inline(always)]
pub(super) fn outvoted(work: &mut Work, settings: &Settings, winner: usize) -> bool {
    let Work { sample, information, trials, .. } = work;
    let labels = &trials[winner];
    let (many, most) = (accused(sample, labels).count(), settings.most(sample));
    if many > most && contested(sample, labels, information) > most {
        return true;
    }
    many >= FEW && settings.has(Part::Votes) && outweighed(sample, labels, information)
}

/// How many of the accused see something of what any other sensor sees.
#[inline(always)]
fn contested(sample: &Sample, labels: &Labels, information: &mut Information) -> usize {
    information.clear();
    for channel in 0..information.count() {
        information.weigh(unit(information, channel), channel);
    }
    information.update();
    let alone = |channel: usize| leverage(information, channel) > 0.5 - ROUNDING; // z zᵀ alone beside I
    accused(sample, labels).filter(|one| !(one.first..one.first + one.size).all(alone)).count()
}

/// Whether accused sensors that see the same line outweigh the believed along it.
#[inline(always)]
fn outweighed(sample: &Sample, labels: &Labels, information: &mut Information) -> bool {
    information.clear();
    for (index, one) in sample.arrived.iter().enumerate() {
        for channel in one.first..one.first + one.size {
            if labels.believes(index) {
                let factor = unit(information, channel) * if one.protected { PROTECTED } else { 1.0 };
                information.weigh(factor, channel);
            }
        }
    }
    information.update();
    accused(sample, labels).flat_map(|one| one.first..one.first + one.size).any(|channel| {
        let alike =
            accused(sample, labels).filter(|other| sees_the_same(information, channel, other)).count();
        alike >= FEW && alike as f64 * leverage(information, channel) > 1.0 + ROUNDING
    })
}

/// zᵀ (I + T)⁻¹ z for the unit vector z of a channel.
#[inline(always)]
fn leverage(information: &Information, channel: usize) -> f64 {
    let length = unit(information, channel);
    length * length * information.w_t().map(|w| w[channel] * w[channel]).sum::<f64>()
}

/// Whether a sensor sees the state along the line of a channel.
#[inline(always)]
fn sees_the_same(information: &Information, channel: usize, other: &Arrived) -> bool {
    let (z, length) = (information.z(channel), unit(information, channel));
    (other.first..other.first + other.size).any(|own| {
        let cosine = length * unit(information, own) * dot(z, information.z(own));
        cosine.abs() > SAME
    })
}

/// The sensors that are not believed.
#[inline(always)]
fn accused<'a>(sample: &'a Sample, labels: &'a Labels) -> impl Iterator<Item = &'a Arrived> {
    sample.arrived.iter().enumerate().filter(|(index, _)| !labels.believes(*index)).map(|(_, one)| one)
}

/// Inverse length of a row of Z.
#[inline(always)]
fn unit(information: &Information, channel: usize) -> f64 {
    let z = information.z(channel);
    let square = dot(z, z);
    if square > 0.0 { 1.0 / square.sqrt() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::kalman::model::{Matrices, Model};
    use crate::secure::{Secure, State};
    use crate::{Estimator, Record};

    /// Sensors with these rows of C and R = 1 after a sample of zeros, and what was chosen for them.
    fn heard(rows: &[[f64; 2]], protected: &[usize]) -> (State, Settings) {
        let (m, identity) = (rows.len(), vec![1.0, 0.0, 0.0, 1.0]);
        let matrices = Matrices {
            a: identity.clone(),
            b: vec![],
            c: rows.concat(),
            d: vec![],
            q: identity.clone(),
            r: (0..m * m).map(|k| f64::from(u8::from(k / m == k % m))).collect(),
            channel_sensor: (0..m).collect(),
            sensors: m,
            states: 2,
        };
        let guarded = (0..m).map(|i| protected.contains(&i)).collect();
        let owner: Vec<usize> = (0..m).collect();
        let settings = Settings::new((vec![1e-3; m], 1e-4), guarded, &owner, vec![1.0; m]).unwrap();
        let estimator = Secure::new(Model::new(matrices).unwrap(), None, settings.clone()).unwrap();
        let mut state = estimator.start(&[0.0; 2], Some(&identity)).unwrap();
        let mut record = Record::new(estimator.dims(), estimator.diagnostics().len(), 1, 1, true);
        estimator.step(&mut state, &vec![0.0; m], &[], &mut record.split()[0].at(0)).unwrap();
        (state, settings)
    }

    fn too_many(rows: &[[f64; 2]], protected: &[usize], accused: &[usize]) -> bool {
        let (mut state, settings) = heard(rows, protected);
        for (index, belief) in state.work.trials[0].belief.iter_mut().enumerate() {
            *belief = if accused.contains(&index) { [0.0, 0.0, 0.0, 1.0] } else { [1.0, 0.0, 0.0, 0.0] };
        }
        outvoted(&mut state.work, &settings, 0)
    }

    const X: [f64; 2] = [1.0, 0.0];
    const Y: [f64; 2] = [0.0, 2.0];

    #[test]
    fn among_sensors_of_the_same_state_heads_count_and_the_prediction_is_one() {
        assert!(!too_many(&[X; 5], &[], &[]));
        assert!(!too_many(&[X; 5], &[], &[1]) && !too_many(&[X; 5], &[], &[1, 3]));
        assert!(too_many(&[X; 5], &[], &[0, 1, 2]) && too_many(&[X; 5], &[], &[0, 1, 2, 3, 4]));
        assert!(!too_many(&[X; 4], &[], &[1]) && too_many(&[X; 4], &[], &[1, 2]));
    }

    #[test]
    fn among_sensors_that_see_a_part_those_who_see_the_same_count() {
        let rows = [X, X, X, X, Y, Y, Y, Y, Y];
        assert!(too_many(&rows, &[], &[0, 1, 2]) && !too_many(&rows, &[], &[4, 5]));
        assert!(!too_many(&rows, &[], &[0, 1, 4]) && too_many(&rows, &[], &[4, 5, 6, 7]));
    }

    #[test]
    fn a_protected_sensor_outvotes_everybody_who_sees_the_same() {
        let rows = [X, X, X, X, Y, Y, Y, Y];
        assert!(!too_many(&rows, &[0], &[1, 2, 3]) && too_many(&rows, &[0], &[4, 5, 6]));
    }

    #[test]
    fn a_direction_in_which_states_cancel_is_found() {
        let (along, across) = ([1.0, 1.0], [1.0, -1.0]);
        let rows = [along, along, along, along, across, across, across, across];
        assert!(too_many(&rows, &[], &[1, 2, 3]) && too_many(&rows, &[], &[5, 6, 7]));
    }

    #[test]
    fn as_many_as_are_believed_are_not_more() {
        for believed in 2..6 {
            let rows = [vec![X; 2 * believed + 1], vec![Y; 2 * believed + 1]].concat();
            let accused: Vec<usize> = (0..believed + 2).collect();
            assert!(!too_many(&rows, &[], &accused[1..]) && too_many(&rows, &[], &accused), "{believed}");
        }
    }
}
