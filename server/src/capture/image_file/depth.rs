//! Depth of 16-bit samples. Cameras' 10, 12 or 14 bits are often saved as they come, in the lower bits.
//!
//! PNG's sBIT chunk would tell, but is seldom written. Otherwise the largest sample decides, unless the lowest bits are
//! never used: then the samples are scaled, and the picture is dark. A picture with 16 bits that is dark throughout is
//! taken for a shallower one, hence brightened by a power of two; callers report it.

/// Depths of cameras.
const DEPTHS: [u8; 3] = [10, 12, 14];

/// The depth of a sequence of pictures with 16-bit samples: the largest so far, so that a dark one is not brightened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SampleDepth {
    bits: Option<u8>,
}

impl SampleDepth {
    /// Depth of the samples, if they are read as less than 16 bits deep.
    pub fn unscaled_bits(self) -> Option<u8> {
        self.bits.filter(|bits| *bits < 16)
    }

    /// Takes a picture into account, with the significant bits that its file declares. Returns the largest sample value.
    pub(super) fn update(&mut self, samples: &[u16], declared: Option<u8>) -> u16 {
        let (most, used) = samples
            .iter()
            .fold((0, 0), |(most, used): (u16, u16), &sample| (most.max(sample), used | sample));
        let fits = |bits: &u8| u32::from(most) < 1 << bits;
        let bits = match declared {
            Some(bits) => Some(bits).filter(|bits| *bits < 16 && fits(bits)),
            None if used & 0b11 == 0 => None,
            None => DEPTHS.into_iter().find(fits),
        };
        let bits = bits.unwrap_or(16).max(self.bits.unwrap_or_default());
        self.bits = Some(bits);
        ((1u32 << bits) - 1) as u16
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn most(samples: &[u16], declared: Option<u8>) -> u16 {
        SampleDepth::default().update(samples, declared)
    }

    #[test]
    fn the_largest_sample_decides() {
        assert_eq!(most(&[3, 891], None), 1023);
        assert_eq!(most(&[3, 3566], None), 4095);
        assert_eq!(most(&[3, 9000], None), 16383);
        assert_eq!(most(&[3, 16384], None), u16::MAX);
        assert_eq!(most(&[0, 0], None), u16::MAX);
        // Scaled samples of 12 bits in a dark picture.
        assert_eq!(most(&[16, 3200], None), u16::MAX);
    }

    #[test]
    fn a_file_may_declare_its_depth() {
        assert_eq!(most(&[3, 891], Some(16)), u16::MAX);
        assert_eq!(most(&[3, 891], Some(12)), 4095);
        assert_eq!(most(&[3, 65_520], Some(12)), u16::MAX);
    }

    #[test]
    fn a_dark_picture_of_a_sequence_is_not_brightened() {
        let mut depth = SampleDepth::default();
        assert_eq!(depth.unscaled_bits(), None);
        for (sample, bits) in [(702, Some(10)), (3001, Some(12)), (701, Some(12)), (40_001, None)] {
            depth.update(&[sample], None);
            assert_eq!(depth.unscaled_bits(), bits, "{sample}");
        }
        assert_eq!(depth.update(&[701], None), u16::MAX);
    }
}
