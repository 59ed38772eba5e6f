//! Filter states as bytes: little endian, no padding, exact to the bit, with a checksum.

use crate::{Error, Result};

const OFFSET: u64 = 0xcbf2_9ce4_8422_2325;
const PRIME: u64 = 0x0000_0100_0000_01b3;

/// FNV-1a hash, fed with numbers: the fingerprint of an estimator and the checksum of a blob.
#[derive(Debug, Clone, Copy)]
pub struct Fingerprint(u64);

impl Default for Fingerprint {
    fn default() -> Self {
        Self(OFFSET)
    }
}

impl Fingerprint {
    /// Mix in bytes.
    #[must_use]
    pub fn bytes(mut self, bytes: &[u8]) -> Self {
        for &byte in bytes {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(PRIME);
        }
        self
    }

    /// Mix in an array, its length included.
    #[must_use]
    pub fn floats(self, values: &[f64]) -> Self {
        let start = self.bytes(&(values.len() as u64).to_le_bytes());
        values.iter().fold(start, |hash, v| hash.bytes(&v.to_bits().to_le_bytes()))
    }

    /// Mix in whole numbers, their count included.
    #[must_use]
    pub fn sizes(self, values: &[usize]) -> Self {
        let start = self.bytes(&(values.len() as u64).to_le_bytes());
        values.iter().fold(start, |hash, &v| hash.bytes(&(v as u64).to_le_bytes()))
    }

    /// The hash.
    #[must_use]
    pub fn finish(self) -> u64 {
        self.0
    }
}

/// Writes a filter state.
#[derive(Debug, Default)]
pub struct Encoder {
    bytes: Vec<u8>,
}

impl Encoder {
    /// Append a whole number.
    pub fn integer(&mut self, value: u64) {
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// Append an array, its length included.
    pub fn floats(&mut self, values: &[f64]) {
        self.integer(values.len() as u64);
        for value in values {
            self.bytes.extend_from_slice(&value.to_bits().to_le_bytes());
        }
    }

    /// The bytes written so far, followed by their checksum.
    #[must_use]
    pub fn finish(mut self) -> Vec<u8> {
        let checksum = Fingerprint::default().bytes(&self.bytes).finish();
        self.integer(checksum);
        self.bytes
    }
}

/// Reads what [`Encoder`] wrote, in the same order.
#[derive(Debug)]
pub struct Decoder<'a> {
    bytes: &'a [u8],
}

impl<'a> Decoder<'a> {
    /// Check the checksum and start reading.
    ///
    /// # Errors
    /// [`Error::Resume`] if the bytes are too short or damaged.
    pub fn new(blob: &'a [u8]) -> Result<Self> {
        let damaged = || Error::Resume("the saved filter state is damaged or cut short".into());
        let split = blob.len().checked_sub(8).ok_or_else(damaged)?;
        let (bytes, mut tail) = blob.split_at(split);
        let checksum = take_u64(&mut tail).ok_or_else(damaged)?;
        if Fingerprint::default().bytes(bytes).finish() != checksum {
            return Err(damaged());
        }
        Ok(Self { bytes })
    }

    /// Read a whole number.
    ///
    /// # Errors
    /// [`Error::Resume`] at the end of the bytes.
    pub fn integer(&mut self) -> Result<u64> {
        take_u64(&mut self.bytes).ok_or_else(|| Error::Resume("the saved filter state ends too early".into()))
    }

    /// Read an array into `target`, whose length must agree.
    ///
    /// # Errors
    /// [`Error::Resume`] if the lengths differ or the bytes end.
    pub fn floats(&mut self, target: &mut [f64]) -> Result<()> {
        let count = self.integer()?;
        if count != target.len() as u64 {
            return Err(Error::Resume(format!(
                "the saved filter state holds an array of {count} numbers where {} belong",
                target.len()
            )));
        }
        for value in target {
            *value = f64::from_bits(self.integer()?);
        }
        Ok(())
    }

    /// `Ok` if everything was read.
    ///
    /// # Errors
    /// [`Error::Resume`] if bytes are left over.
    pub fn finish(self) -> Result<()> {
        if self.bytes.is_empty() {
            return Ok(());
        }
        Err(Error::Resume(format!("{} bytes too many in the saved filter state", self.bytes.len())))
    }
}

fn take_u64(bytes: &mut &[u8]) -> Option<u64> {
    let (head, rest) = bytes.split_first_chunk::<8>()?;
    *bytes = rest;
    Some(u64::from_le_bytes(*head))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_survive_to_the_bit() {
        let values = [0.1, -0.0, f64::NAN, f64::INFINITY, f64::MIN_POSITIVE / 3.0];
        let mut encoder = Encoder::default();
        encoder.integer(7);
        encoder.floats(&values);
        let blob = encoder.finish();
        let mut decoder = Decoder::new(&blob).unwrap();
        let mut back = [0.0; 5];
        assert_eq!(decoder.integer().unwrap(), 7);
        decoder.floats(&mut back).unwrap();
        decoder.finish().unwrap();
        assert_eq!(values.map(f64::to_bits), back.map(f64::to_bits));
    }

    #[test]
    fn every_flipped_bit_is_noticed() {
        let mut encoder = Encoder::default();
        encoder.floats(&[1.0, 2.0, 3.0]);
        let blob = encoder.finish();
        for bit in 0..blob.len() * 8 {
            let mut damaged = blob.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(Decoder::new(&damaged).is_err(), "bit {bit}");
        }
    }
}
