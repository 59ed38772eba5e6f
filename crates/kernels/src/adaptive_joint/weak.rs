//! What the channels that may lie say, given those that cannot.
//!
//! ```text
//!     ν = z_w − R_wp R_pp⁻¹ z_p − C_w|p (x − x⁻),   C_w|p = C_w − R_wp R_pp⁻¹ C_p,   R_w|p = R_ww − R_wp R_pp⁻¹ R_pw
//!     S = C_w|p P C_w|pᵀ + R_w|p,   x and P given y_p
//! ```
//!
//! With L Lᵀ = R and the protected channels p first, R_wp R_pp⁻¹ z_p is L_wp times what the filter has whitened anyway,
//! and R_w|p the rest of L times its transpose. No reading of a weak channel enters the ν of another.

use crate::kalman::alone::{Alone, Rows};
use crate::kalman::gains::Scratch;
use crate::kalman::heard::Heard;
use crate::kalman::model::Model;
use crate::kalman::ud::Ud;
use crate::kalman::whitening::{Noise, Whitening};
use crate::linalg::{axpy, dot};

/// The weak channels that arrived, in increasing order.
#[derive(Debug, Clone)]
pub struct Weak {
    /// ν, (weak channels that arrived,).
    pub nu: Vec<f64>,
    /// S, the same.
    pub variance: Vec<f64>,
    /// Channels heard before them: the protected ones.
    pub from: usize,
    /// R_w|p without the correlation between sensors.
    noise: Noise,
    whitening: Whitening,
    /// C_w|p
    rows: Vec<f64>,
    /// C_w|p and ν, whitened for each sensor alone.
    white_rows: Vec<f64>,
    white: Vec<f64>,
    row: Vec<f64>,
    alone: Alone,
}

impl Weak {
    /// Room for one sample.
    #[must_use]
    pub fn new(model: &Model) -> Self {
        let (n, m) = (model.dims.states, model.dims.channels);
        let noise = Noise::blocks(&model.channel_sensor);
        Self {
            nu: vec![0.0; m],
            variance: vec![0.0; m],
            from: 0,
            whitening: Whitening::new(&noise),
            noise,
            rows: vec![0.0; m * n],
            white_rows: vec![0.0; m * n],
            white: vec![0.0; m],
            row: vec![0.0; n],
            alone: Alone::new(model),
        }
    }

    /// The part that does not see data: S, and gains of every weak sensor alone. The first `from` channels heard are
    /// the protected ones, and P given them is `p`.
    pub fn listen(&mut self, model: &Model, k: usize, heard: &Heard, from: usize, p: &Ud) {
        let (n, m, channels) = (model.dims.states, model.dims.channels, &heard.channels()[from..]);
        self.from = from;
        self.note_rows(model, k, heard);
        self.note_noise(model, heard);
        let rows = &self.rows[..channels.len() * n];
        for ((&channel, row), variance) in channels.iter().zip(rows.chunks_exact(n)).zip(&mut self.variance) {
            let noise = self.noise.r[channel * m + channel];
            let scale = 1.0 / noise.sqrt();
            self.row.iter_mut().zip(row).for_each(|(target, value)| *target = scale * value);
            *variance = noise * p.variance(&self.row);
        }
        self.white_rows[..rows.len()].copy_from_slice(rows);
        self.whitening.apply_to_rows(&mut self.white_rows[..rows.len()], n);
        self.alone.listen(rows_of(model, channels, &self.white_rows), p);
    }

    /// C_w|p.
    fn note_rows(&mut self, model: &Model, k: usize, heard: &Heard) {
        let (n, c, white) = (model.dims.states, model.c(k), heard.rows());
        let channels = heard.channels().iter().enumerate().skip(self.from);
        for ((i, &channel), row) in channels.zip(self.rows.chunks_exact_mut(n)) {
            row.copy_from_slice(&c[channel * n..(channel + 1) * n]);
            let (first, coupling) = heard.whitening().coupling(i, self.from);
            for (l, other) in coupling.iter().zip(white[first * n..].chunks_exact(n)) {
                axpy(-l, other, row);
            }
        }
    }

    /// R_w|p of the channels of each sensor, and its Cholesky factors.
    fn note_noise(&mut self, model: &Model, heard: &Heard) {
        let (m, owner) = (model.dims.channels, &model.channel_sensor);
        let channels = &heard.channels()[self.from..];
        let mut fill = |between: bool| {
            for (i, &a) in channels.iter().enumerate() {
                let own = channels[..=i].iter().rev().take_while(|&&b| owner[b] == owner[a]);
                for (back, &b) in own.enumerate() {
                    let (row, known) = (self.from + i, between || back == 0);
                    let covariance = heard.whitening().covariance_given(self.from, row, row - back);
                    self.noise.r[a * m + b] = if known { covariance } else { 0.0 };
                }
            }
            self.whitening.factorise(&self.noise, channels)
        };
        // R_w|p is positive definite; if rounding makes it none, the variances alone do.
        let _ = fill(true) || fill(false);
    }

    /// The part that sees data: ν, and d_i² over its quantile in `excess` (N,), NaN for a sensor without a channel
    /// here. ν beyond `limit` counts as that far.
    ///
    /// `scratch` holds x − x⁻ by the protected channels and their whitened innovations.
    pub fn measure(
        &mut self,
        model: &Model,
        heard: &Heard,
        (innovation, limit): (&[f64], f64),
        quantiles: &[f64],
        scratch: &mut Scratch,
        excess: &mut [f64],
    ) {
        let n = model.dims.states;
        let channels = heard.channels().iter().enumerate().skip(self.from);
        for (((i, &channel), row), nu) in channels.zip(self.rows.chunks_exact(n)).zip(&mut self.nu) {
            let (first, coupling) = heard.whitening().coupling(i, self.from);
            let known = dot(coupling, &scratch.channel[first..first + coupling.len()]);
            *nu = innovation[channel] - known - dot(row, &scratch.state);
        }
        let channels = &heard.channels()[self.from..];
        let white = &mut self.white[..channels.len()];
        white.iter_mut().zip(&self.nu).for_each(|(white, nu)| *white = nu.clamp(-limit, limit));
        self.whitening.apply(white);
        let of = rows_of(model, channels, &self.white_rows);
        self.alone.excess(of, white, quantiles, &mut scratch.state, excess);
    }
}

fn rows_of<'a>(model: &'a Model, channels: &'a [usize], rows: &'a [f64]) -> Rows<'a> {
    Rows { owner: &model.channel_sensor, channels, rows: &rows[..channels.len() * model.dims.states] }
}
