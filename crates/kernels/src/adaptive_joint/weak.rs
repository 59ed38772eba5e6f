//! What the channels that may lie say, given those that cannot.
//!
//! ```text
//!     ν = z_w − R_wp R_pp⁻¹ z_p − C_w|p (x − x⁻),   C_w|p = C_w − R_wp R_pp⁻¹ C_p,   R_w|p = R_ww − R_wp R_pp⁻¹ R_pw
//!     S = C_w|p P C_w|pᵀ + R_w|p,   x and P given y_p
//! ```
//!
//! With L Lᵀ = R and the protected channels p first, C_w|p, R_w|p and ν are the rows of L that belong to w, without the
//! columns of p, times what the filter has whitened anyway. No inverse and no difference of large numbers is taken.

use crate::kalman::alone::{Alone, Rows};
use crate::kalman::gains::Scratch;
use crate::kalman::heard::Heard;
use crate::kalman::model::Model;
use crate::kalman::ud::Ud;
use crate::kalman::whitening::{Noise, Whitening};
use crate::linalg::dot;

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
    rows: Vec<f64>,
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
            white: vec![0.0; m],
            row: vec![0.0; n],
            alone: Alone::new(model),
        }
    }

    /// The part that does not see data: S, and gains of every weak sensor alone. The first `from` channels heard are
    /// the protected ones, and P given them is `p`.
    pub fn listen(&mut self, model: &Model, heard: &Heard, from: usize, p: &Ud) {
        let n = model.dims.states;
        let (channels, given) = (&heard.channels()[from..], &heard.rows()[from * n..]);
        self.from = from;
        let rows = &mut self.rows[..given.len()];
        rows.copy_from_slice(given);
        heard.whitening().restore_rows(from, rows, n);
        self.note_noise(model, heard);
        let m = model.dims.channels;
        for (j, (&channel, row)) in channels.iter().zip(self.rows.chunks_exact(n)).enumerate() {
            let noise = self.noise.r[channel * m + channel];
            let scale = 1.0 / noise.sqrt();
            self.row.iter_mut().zip(row).for_each(|(target, value)| *target = scale * value);
            self.variance[j] = noise * p.variance(&self.row);
        }
        self.whitening.apply_to_rows(&mut self.rows[..given.len()], n);
        self.alone.listen(rows_of(model, channels, &self.rows), p);
    }

    /// R_w|p of the channels of each sensor, and its Cholesky factors.
    fn note_noise(&mut self, model: &Model, heard: &Heard) {
        let (m, owner) = (model.dims.channels, &model.channel_sensor);
        let channels = &heard.channels()[self.from..];
        let mut fill = |between: bool| {
            for (i, &a) in channels.iter().enumerate() {
                for (j, &b) in channels[..=i].iter().enumerate().filter(|(_, b)| owner[**b] == owner[a]) {
                    let known = between || i == j;
                    let covariance =
                        heard.whitening().covariance_given(self.from, self.from + i, self.from + j);
                    self.noise.r[a * m + b] = if known { covariance } else { 0.0 };
                }
            }
            self.whitening.factorise(&self.noise, channels)
        };
        // R_w|p is positive definite; if rounding makes it none, the variances alone do.
        let _ = fill(true) || fill(false);
    }

    /// The part that sees data: ν, and d_i² over its quantile in `excess` (N,), NaN for a sensor without a channel here.
    ///
    /// `scratch` holds x − x⁻ by the protected channels and the whitened innovations of all channels heard.
    pub fn measure(
        &mut self,
        model: &Model,
        heard: &Heard,
        quantiles: &[f64],
        limit: f64,
        scratch: &mut Scratch,
        excess: &mut [f64],
    ) {
        let (n, channels) = (model.dims.states, &heard.channels()[self.from..]);
        let nu = &mut self.nu[..channels.len()];
        let rows = heard.rows()[self.from * n..].chunks_exact(n);
        for ((nu, row), white) in nu.iter_mut().zip(rows).zip(&scratch.channel[self.from..]) {
            *nu = white - dot(row, &scratch.state);
        }
        heard.whitening().restore(self.from, nu);
        let white = &mut self.white[..channels.len()];
        white.iter_mut().zip(nu).for_each(|(white, nu)| *white = nu.clamp(-limit, limit));
        self.whitening.apply(white);
        let of = rows_of(model, channels, &self.rows);
        self.alone.excess(of, white, quantiles, &mut scratch.state, excess);
    }
}

fn rows_of<'a>(model: &'a Model, channels: &'a [usize], rows: &'a [f64]) -> Rows<'a> {
    Rows { owner: &model.channel_sensor, channels, rows: &rows[..channels.len() * model.dims.states] }
}
