//! What a step says beside x: who is trusted, diagnostics, and what is shown when a recursion has broken down.

use crate::Output;
use crate::estimator::Buffers;

/// Who is trusted: what the detector said. Nothing is injected by those; `owner` (m,) owns the channels. Returns how many they are.
pub fn repeat(owner: &[usize], told: &Buffers, out: &mut Output<'_>) -> usize {
    out.trust.copy_from_slice(&told.trust);
    out.suspected.copy_from_slice(&told.suspected);
    for (channel, &sensor) in owner.iter().enumerate() {
        if told.trust[sensor] > 0.5 && !told.innovation[channel].is_nan() {
            out.attack[channel] = 0.0;
            out.attack_std[channel] = f64::NAN;
        }
    }
    told.trust.iter().filter(|&&trust| trust > 0.5).count()
}

/// Who is trusted: what the protected sensors say of the others; those on the channels `stacked` cannot lie. Returns how many of them sent something.
pub fn judge(
    (owner, stacked): (&[usize], &[usize]),
    y: &[f64],
    alone: Option<&Buffers>,
    out: &mut Output<'_>,
) -> usize {
    out.trust.fill(f64::NAN);
    out.suspected.fill(0);
    if let Some(alone) = alone {
        out.trust.copy_from_slice(&alone.trust);
        out.suspected.copy_from_slice(&alone.suspected);
    }
    let mut count = 0;
    for &channel in stacked.iter().filter(|&&channel| !y[channel].is_nan()) {
        let sensor = owner[channel];
        count += usize::from(out.trust[sensor].is_nan());
        out.trust[sensor] = 1.0;
        out.attack[channel] = 0.0;
        out.attack_std[channel] = 0.0;
    }
    count
}

/// Diagnostics; returns how many of the channels in use arrived.
pub fn report(used: &[usize], y: &[f64], alone: Option<&Buffers>, out: &mut Output<'_>) -> usize {
    let heard = used.iter().filter(|&&channel| !y[channel].is_nan()).count();
    let trace = |std: &[f64]| std.iter().map(|s| s * s).sum::<f64>();
    let gap = |alone: &Buffers| {
        let each = out.x.iter().zip(&alone.x).zip(&alone.x_std);
        each.fold(0.0, |gap: f64, ((x, p), std)| gap.max((x - p).abs() / std))
    };
    let numbers = [
        heard as f64,
        trace(out.x_std),
        alone.map_or(f64::NAN, |alone| trace(&alone.x_std)),
        alone.map_or(f64::NAN, gap),
    ];
    out.diagnostics[..4].copy_from_slice(&numbers);
    heard
}

/// The estimate of the protected sensors, or the prediction if there is none. `whole`: `alone` has its covariance, not
/// only the deviations.
pub fn fall_back(alone: Option<&Buffers>, whole: bool, predicted: &[f64], out: &mut Output<'_>) {
    match alone {
        Some(alone) => {
            out.x.copy_from_slice(&alone.x);
            out.x_std.copy_from_slice(&alone.x_std);
            if let Some(covariance) = out.covariance.as_deref_mut() {
                match whole {
                    true => covariance.copy_from_slice(&alone.covariance),
                    false => set_diagonal(covariance, alone.x_std.iter().map(|std| std * std)),
                }
            }
            out.attack.copy_from_slice(&alone.attack);
            out.attack_std.copy_from_slice(&alone.attack_std);
        }
        None => {
            out.x.copy_from_slice(predicted);
            out.x_std.fill(f64::INFINITY);
            if let Some(covariance) = out.covariance.as_deref_mut() {
                set_diagonal(covariance, predicted.iter().map(|_| f64::INFINITY));
            }
            out.attack.fill(f64::NAN);
            out.attack_std.fill(f64::NAN);
        }
    }
}

/// A diagonal matrix.
fn set_diagonal(matrix: &mut [f64], diagonal: impl ExactSizeIterator<Item = f64>) {
    let step = diagonal.len() + 1;
    matrix.fill(0.0);
    matrix.iter_mut().step_by(step).zip(diagonal).for_each(|(entry, value)| *entry = value);
}
