//! Words up to rotation: a necklace is the smallest of a word's rotations.

/// The largest minimum distance with at least two identities; 1 if there is only one identity.
pub(super) fn max_distance(bits: u8) -> u8 {
    // The first identity is the smallest necklace, 0…01; the largest distance of another one from
    // it is the limit.
    let first = 1;
    let others = necklaces(bits).filter(|&word| word != first && !is_periodic(word, bits));
    others.map(|word| rotation_distance(first, word, bits)).max().unwrap_or(1)
}

/// Rotation to the left by `shift` < `bits` bits.
pub(super) fn rotated(word: u16, shift: u8, bits: u8) -> u16 {
    let (word, mask) = (u32::from(word), (1u32 << bits) - 1);
    ((word << shift | word >> (bits - shift)) & mask) as u16
}

/// Words that are the smallest of their rotations, ascending.
pub(super) fn necklaces(bits: u8) -> impl Iterator<Item = u16> {
    let last = ((1u32 << bits) - 1) as u16;
    (0..=last).filter(move |&word| (1..bits).all(|shift| rotated(word, shift, bits) >= word))
}

pub(super) fn is_periodic(word: u16, bits: u8) -> bool {
    (1..bits).any(|shift| rotated(word, shift, bits) == word)
}

pub(super) fn rotation_distance(one: u16, other: u16, bits: u8) -> u8 {
    (0..bits)
        .fold(bits, |min, shift| min.min((one ^ rotated(other, shift, bits)).count_ones() as u8))
}
