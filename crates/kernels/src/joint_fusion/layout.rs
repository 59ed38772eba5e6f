//! Who is stacked with whom: one local estimator per sensor that may lie.

use std::ops::Range;

use crate::{Error, Result};

/// A sensor that may lie, stacked with sensors that do not (3).
#[derive(Debug, Clone, PartialEq)]
pub struct Local {
    /// The sensor that may lie.
    pub sensor: usize,
    /// p_i, its channels; they come first in `channels`.
    pub weak: usize,
    /// The plant's channel behind every row of C_i, (m_i,).
    pub channels: Vec<usize>,
    /// Where its rows begin among those of all locals.
    pub first_row: usize,
    /// Where its injections θ_i begin among those of all locals.
    pub first_weak: usize,
    /// Where its state [x; θ; φ] begins among those of all locals.
    pub first_state: usize,
}

impl Local {
    /// m_i.
    #[must_use]
    pub fn height(&self) -> usize {
        self.channels.len()
    }

    /// n + 2 p_i, length of s_i = [x̃; −θ̂; φ̂].
    #[must_use]
    pub fn size(&self, n: usize) -> usize {
        n + 2 * self.weak
    }

    /// Its rows among those of all locals.
    #[must_use]
    pub fn rows(&self) -> Range<usize> {
        self.first_row..self.first_row + self.height()
    }

    /// Its state among those of all locals.
    #[must_use]
    pub fn state(&self, n: usize) -> Range<usize> {
        self.first_state..self.first_state + self.size(n)
    }
}

/// All local estimators.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// n.
    pub n: usize,
    /// One per sensor that may lie.
    pub locals: Vec<Local>,
    /// Rows of all C_i.
    pub rows: usize,
    /// Injections of all locals, Σ p_i.
    pub weak: usize,
    /// Numbers in all states [x; θ; φ].
    pub states: usize,
    /// The plant's channels that some local uses, in increasing order.
    pub used: Vec<usize>,
}

impl Layout {
    /// Stack every `(weak channels, protected channels)`.
    ///
    /// # Errors
    /// No local at all, a local without channels of its own, or a channel that does not exist.
    pub fn new(n: usize, owner: &[usize], stacks: &[(Vec<usize>, Vec<usize>)]) -> Result<Self> {
        let mut layout = Self { n, locals: Vec::new(), rows: 0, weak: 0, states: 0, used: Vec::new() };
        for (own, others) in stacks {
            let channels = [own.as_slice(), others.as_slice()].concat();
            let known = channels.iter().all(|&channel| channel < owner.len());
            let (true, Some(&first)) = (known, own.first()) else {
                return Err(Error::input("pairing", "channels of the plant", format!("{channels:?}")));
            };
            let local = Local {
                sensor: owner[first],
                weak: own.len(),
                channels,
                first_row: layout.rows,
                first_weak: layout.weak,
                first_state: layout.states,
            };
            layout.rows += local.height();
            layout.weak += local.weak;
            layout.states += local.size(n);
            layout.locals.push(local);
        }
        let in_use = |channel: &usize| layout.locals.iter().any(|l| l.channels.contains(channel));
        layout.used = (0..owner.len()).filter(in_use).collect();
        if layout.locals.is_empty() {
            return Err(Error::input("pairing", "at least one sensor that may lie", "none"));
        }
        Ok(layout)
    }

    /// r, local estimators.
    #[must_use]
    pub fn count(&self) -> usize {
        self.locals.len()
    }

    /// All pairs i ≤ j in the order in which their moments are kept.
    pub fn pairs(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let count = self.count();
        (0..count).flat_map(move |i| (i..count).map(move |j| (i, j)))
    }

    /// Where pair i ≤ j is kept.
    #[must_use]
    pub fn pair(&self, i: usize, j: usize) -> usize {
        i * self.count() - i * (i + 1) / 2 + j
    }
}

/// What decides the gains of one step: which rows arrived, and how large an injection is assumed.
#[derive(Debug, Clone, PartialEq)]
pub struct Pattern {
    /// Whether a row counts, (rows,).
    pub heard: Vec<bool>,
    /// Variance η of every injection, (Σ p_i,).
    pub eta: Vec<f64>,
}

impl Pattern {
    /// Every row counts.
    #[must_use]
    pub fn full(layout: &Layout, eta: &[f64]) -> Self {
        Self { heard: vec![true; layout.rows], eta: eta.to_vec() }
    }

    /// Overwrite, without allocation.
    pub fn copy_from(&mut self, other: &Self) {
        self.heard.copy_from_slice(&other.heard);
        self.eta.copy_from_slice(&other.eta);
    }

    /// η of injection `q` of a local if that channel arrived, else 0: then nothing was injected into the sample.
    #[must_use]
    pub fn variance(&self, local: &Local, q: usize) -> f64 {
        if self.heard[local.first_row + q] { self.eta[local.first_weak + q] } else { 0.0 }
    }
}
