//! Steps of bytes by the bits of masks: how a scan changes the classes of a block.

use super::{Kind, Path};

/// One row of a block: a byte a leaf.
type Row = [u8; 64];

/// In every row `y`, adds 1 to the bytes whose bit is in `up[y]` and takes 1 from those whose bit is in `down[y]` and not in
/// `up[y]`, held to `lowest..=highest`. Returns the rows in which a byte changed, as bits.
pub fn step_rows(path: Path, rows: &mut [Row; 64], up: &[u64; 64], down: &[u64; 64], lowest: u8, highest: u8) -> u64 {
    match path.kind() {
        Kind::Portable => portable(rows, up, down, lowest, highest),
        // SAFETY: a path of this kind exists only where the processor has the features that the function is compiled for.
        #[cfg(target_arch = "x86_64")]
        #[expect(unsafe_code, reason = "a call of code for instructions that were found on this machine")]
        Kind::Avx2 => unsafe { x86::avx2(rows, up, down, lowest, highest) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        #[expect(unsafe_code, reason = "a call of code for instructions that were found on this machine")]
        Kind::Avx512 => unsafe { x86::avx512(rows, up, down, lowest, highest) },
    }
}

/// Bit `i` of a byte as byte `i`, 0 or 1.
static SPREAD: [[u8; 8]; 256] = spread_table();

const fn spread_table() -> [[u8; 8]; 256] {
    let mut table = [[0; 8]; 256];
    let mut word = 0;
    while word < 256 {
        let mut bit = 0;
        while bit < 8 {
            table[word][bit] = (word >> bit) as u8 & 1;
            bit += 1;
        }
        word += 1;
    }
    table
}

fn spread(mask: u64) -> Row {
    let mut bytes = [0; 64];
    for (eight, word) in bytes.as_chunks_mut::<8>().0.iter_mut().zip(mask.to_le_bytes()) {
        *eight = SPREAD[usize::from(word)];
    }
    bytes
}

/// Plain loops over bytes, which compile to whatever vectors there are.
fn portable(rows: &mut [Row; 64], up: &[u64; 64], down: &[u64; 64], lowest: u8, highest: u8) -> u64 {
    let mut changed = 0;
    for (y, row) in rows.iter_mut().enumerate() {
        let (up, down) = (up[y], down[y] & !up[y]);
        if up | down == 0 {
            continue;
        }
        let before = *row;
        if up != 0 {
            for (byte, add) in row.iter_mut().zip(&spread(up)) {
                *byte = byte.saturating_add(*add).min(highest);
            }
        }
        if down != 0 {
            for (byte, take) in row.iter_mut().zip(&spread(down)) {
                *byte = byte.saturating_sub(*take).max(lowest);
            }
        }
        let differs = before.iter().zip(&*row).fold(0, |differs, (old, new)| differs | (old ^ new));
        changed |= u64::from(differs != 0) << y;
    }
    changed
}

#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "loads and stores of whole rows by vector instructions take pointers")]
mod x86 {
    use super::Row;
    use std::arch::x86_64::*;

    #[target_feature(enable = "avx2,avx512f,avx512bw")]
    pub(super) fn avx512(rows: &mut [Row; 64], up: &[u64; 64], down: &[u64; 64], lowest: u8, highest: u8) -> u64 {
        let (one, low, high) = (_mm512_set1_epi8(1), _mm512_set1_epi8(lowest as i8), _mm512_set1_epi8(highest as i8));
        let mut changed = 0;
        for (y, row) in rows.iter_mut().enumerate() {
            let (up, down) = (up[y], down[y] & !up[y]);
            if up | down == 0 {
                continue;
            }
            // SAFETY: a row is 64 bytes, and the load has no alignment to keep.
            let before = unsafe { _mm512_loadu_si512(row.as_ptr().cast()) };
            let raised = _mm512_mask_min_epu8(before, up, _mm512_adds_epu8(before, one), high);
            let after = _mm512_mask_max_epu8(raised, down, _mm512_subs_epu8(raised, one), low);
            changed |= u64::from(_mm512_cmpneq_epi8_mask(before, after) != 0) << y;
            // SAFETY: as the load.
            unsafe { _mm512_storeu_si512(row.as_mut_ptr().cast(), after) };
        }
        changed
    }

    /// Bytes of ones where the bits of a mask are set.
    #[target_feature(enable = "avx2")]
    fn bytes_of(mask: u32) -> __m256i {
        let each = _mm256_setr_epi8(
            0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3, 3,
        );
        let bit = _mm256_set1_epi64x(0x8040_2010_0804_0201_u64 as i64);
        let spread = _mm256_shuffle_epi8(_mm256_set1_epi32(mask as i32), each);
        _mm256_cmpeq_epi8(_mm256_and_si256(spread, bit), bit)
    }

    #[target_feature(enable = "avx2")]
    pub(super) fn avx2(rows: &mut [Row; 64], up: &[u64; 64], down: &[u64; 64], lowest: u8, highest: u8) -> u64 {
        let (one, low, high) = (_mm256_set1_epi8(1), _mm256_set1_epi8(lowest as i8), _mm256_set1_epi8(highest as i8));
        let mut changed = 0;
        for (y, row) in rows.iter_mut().enumerate() {
            let (up, down) = (up[y], down[y] & !up[y]);
            if up | down == 0 {
                continue;
            }
            for (half, bytes) in row.as_chunks_mut::<32>().0.iter_mut().enumerate() {
                let (up, down) = ((up >> (32 * half)) as u32, (down >> (32 * half)) as u32);
                // SAFETY: half a row is 32 bytes, and the load has no alignment to keep.
                let before = unsafe { _mm256_loadu_si256(bytes.as_ptr().cast()) };
                let added = _mm256_adds_epu8(before, _mm256_and_si256(bytes_of(up), one));
                let raised = _mm256_min_epu8(added, high);
                let taken = _mm256_subs_epu8(raised, _mm256_and_si256(bytes_of(down), one));
                let after = _mm256_max_epu8(taken, low);
                let same = _mm256_movemask_epi8(_mm256_cmpeq_epi8(before, after));
                changed |= u64::from(same != -1) << y;
                // SAFETY: as the load.
                unsafe { _mm256_storeu_si256(bytes.as_mut_ptr().cast(), after) };
            }
        }
        changed
    }
}
