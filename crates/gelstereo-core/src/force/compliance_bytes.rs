//! Serialised compliance matrices, for files: little-endian.
//!
//! ```text
//! magic 8 | version u32 | rows u32 | cols u32
//! pitch, thickness, Poisson's ratio, rim along rows, rim along columns: f64 each
//! entries, f32 each | digest u64 of all before
//! ```

use super::compliance::{Compliance, ComplianceError, ComplianceGel};
use crate::digest::Digest;
use crate::layer::Layer;
use alloc::vec::Vec;

const MAGIC: &[u8; 8] = b"gelcompl";
const HEAD: usize = MAGIC.len() + 3 * 4 + 5 * 8;
const TAIL: usize = 8;

impl Compliance {
    /// The whole matrix as bytes.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let ComplianceGel { rows, cols, pitch_mm, layer, rim_mm } = *self.gel();
        let mut out = MAGIC.to_vec();
        // Rows and columns are at most 64.
        for number in [Self::VERSION, rows as u32, cols as u32] {
            out.extend(number.to_le_bytes());
        }
        for number in [pitch_mm, layer.thickness_mm, layer.poisson_ratio, rim_mm[0], rim_mm[1]] {
            out.extend(number.to_le_bytes());
        }
        self.values().iter().for_each(|value| out.extend(value.to_le_bytes()));
        let digest = Digest::new().bytes(&out).value();
        out.extend(digest.to_le_bytes());
        out
    }

    /// The matrix written by [`Self::to_bytes`].
    ///
    /// # Errors
    /// [`ComplianceError`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, ComplianceError> {
        if !bytes.starts_with(MAGIC) {
            return Err(ComplianceError::NotACompliance);
        }
        let damaged = ComplianceError::Damaged;
        let version = u32_at(bytes, MAGIC.len()).ok_or(damaged)?;
        if version != Self::VERSION {
            return Err(ComplianceError::Version { found: version });
        }
        let end = bytes.len().checked_sub(TAIL).filter(|&end| end >= HEAD).ok_or(damaged)?;
        if u64_at(bytes, end) != Some(Digest::new().bytes(&bytes[..end]).value()) {
            return Err(damaged);
        }
        let count = |k: usize| u32_at(bytes, MAGIC.len() + 4 * k).map(|count| count as usize).ok_or(damaged);
        let number = |k: usize| u64_at(bytes, MAGIC.len() + 12 + 8 * k).map(f64::from_bits).ok_or(damaged);
        let gel = ComplianceGel {
            rows: count(1)?,
            cols: count(2)?,
            pitch_mm: number(0)?,
            layer: Layer { thickness_mm: number(1)?, poisson_ratio: number(2)? },
            rim_mm: [number(3)?, number(4)?],
        };
        let (entries, rest) = bytes[HEAD..end].as_chunks::<4>();
        if !rest.is_empty() {
            return Err(damaged);
        }
        Self::new(gel, entries.iter().map(|&entry| f32::from_le_bytes(entry)).collect())
    }
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().map(|&four| u32::from_le_bytes(four))
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    bytes.get(at..)?.first_chunk().map(|&eight| u64::from_le_bytes(eight))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn matrix(rows: usize, cols: usize, seed: u64) -> Compliance {
        let layer = Layer { thickness_mm: 3.0, poisson_ratio: 0.48 };
        let gel = ComplianceGel { rows, cols, pitch_mm: 0.9, layer, rim_mm: [1.5, 2.0] };
        let mut random = crate::math::random::Stream::new(seed, "compliance");
        Compliance::new(gel, (0..gel.entries()).map(|_| random.normal() as f32).collect()).unwrap()
    }

    proptest! {
        /// Bytes give the same matrix, and a changed or missing byte is an error.
        #[test]
        fn bytes_give_the_same_matrix_or_an_error(
            (rows, cols) in (2_usize..6, 2_usize..6), seed in any::<u64>(), place in 0.0..1.0_f64,
            flip in 1_u8..=255,
        ) {
            let made = matrix(rows, cols, seed);
            let mut bytes = made.to_bytes();
            prop_assert_eq!(Compliance::from_bytes(&bytes), Ok(made));
            let at = (place * bytes.len() as f64) as usize;
            prop_assert!(Compliance::from_bytes(&bytes[..at]).is_err());
            bytes[at] ^= flip;
            prop_assert!(Compliance::from_bytes(&bytes).is_err());
        }

        /// Mirrored twice or not at all, markers and cells are the same; motion and tractions across the
        /// mirror are reversed.
        #[test]
        fn mirrored_markers_and_cells_move_as_in_a_mirror(
            (rows, cols) in (2_usize..7, 2_usize..7),
            seed in any::<u64>(),
            places in prop::array::uniform4(0_usize..7),
        ) {
            let made = matrix(rows, cols, seed);
            let [a, b, c, d] = places;
            let (marker, cell) = ((a % rows, b % cols), (c % rows, d % cols));
            // The middle row is its own image, which the random entries of this matrix are not.
            prop_assume!(2 * marker.0 + 1 != rows && 2 * marker.1 + 1 != cols);
            let down = |(row, col): (usize, usize)| (rows - 1 - row, col);
            let aside = |(row, col): (usize, usize)| (row, cols - 1 - col);
            let own = made.effect(marker, cell);
            for (image, signs) in [
                (made.effect(down(marker), down(cell)), [1.0, 1.0, -1.0]),
                (made.effect(aside(marker), aside(cell)), [1.0, -1.0, 1.0]),
            ] {
                for (i, k) in (0..9).map(|n| (n / 3, n % 3)) {
                    prop_assert_eq!(own[i][k], image[i][k] * signs[i] * signs[k]);
                }
            }
        }
    }

    #[test]
    fn errors_say_what_is_valid() {
        let made = matrix(2, 3, 1);
        let said = |error: ComplianceError| alloc::format!("{error}");
        let mut gel = *made.gel();
        let short = Compliance::new(gel, alloc::vec![0.0; 5]).unwrap_err();
        assert!(said(short).contains("5 entries; a lattice of this size has 108"), "{short}");
        gel.rows = 65;
        assert!(said(Compliance::new(gel, Vec::new()).unwrap_err()).contains("valid is 2 to 64"));
        let mut bad = made.values().to_vec();
        bad[7] = f32::NAN;
        assert_eq!(Compliance::new(*made.gel(), bad), Err(ComplianceError::NotFinite { index: 7 }));
        assert_eq!(Compliance::from_bytes(b"template"), Err(ComplianceError::NotACompliance));
        let layer = made.gel().layer;
        assert_eq!(made.check_fit([3, 2], 0.9, &layer, Some(1.5)).map_err(said), {
            Err("force.rim_mm is 1.5, but the compliance matrix is of a gel where it is 2; make one with \
                 gelstereo.force.compute_compliance for this sensor"
                .into())
        });
        assert_eq!(made.check_fit([3, 2], 0.905, &layer, None), Ok(()));
        for (counts, pitch_mm, name) in
            [([2, 2], 0.9, "columns"), ([3, 3], 0.9, "rows"), ([3, 2], 0.92, "pitch")]
        {
            assert!(said(made.check_fit(counts, pitch_mm, &layer, None).unwrap_err()).contains(name));
        }
        let thicker = Layer { thickness_mm: 3.1, ..layer };
        assert!(
            said(made.check_fit([3, 2], 0.9, &thicker, None).unwrap_err()).contains("force.thickness_mm")
        );
    }
}
