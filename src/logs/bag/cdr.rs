//! CDR, the encoding of ROS 2 messages: numbers aligned to their size, behind four bytes that tell the byte order.
//!
//! Written by hand, since a message comes from outside: every length is held against the bytes that are there before memory
//! is spent on it, and every error names the field.

/// Longest name (frame, child frame) that is taken, bytes.
const LONGEST_NAME: usize = 1024;

/// Reads the fields of a message one after the other.
#[derive(Debug, Clone)]
pub(super) struct Cdr<'a> {
    /// Without the four bytes in front: alignment counts from behind them.
    bytes: &'a [u8],
    at: usize,
    little: bool,
}

impl<'a> Cdr<'a> {
    /// Reads the four bytes in front.
    ///
    /// # Errors
    /// A sentence for what is not plain CDR.
    pub(super) fn new(message: &'a [u8]) -> Result<Self, String> {
        let Some((head, bytes)) = message.split_first_chunk::<4>() else {
            return Err(format!("has {} bytes, a message has at least 4", message.len()));
        };
        let little = match head[..2] {
            [0, 0] => false,
            [0, 1] => true,
            _ => {
                return Err(format!(
                    "its encoding is {:02x} {:02x}: only plain CDR (00 00, 00 01) is read",
                    head[0], head[1]
                ));
            }
        };
        Ok(Self { bytes, at: 0, little })
    }

    fn take(&mut self, count: usize, align: usize, field: &str) -> Result<&'a [u8], String> {
        let start = self.at.next_multiple_of(align);
        let end = start.saturating_add(count);
        let taken = self
            .bytes
            .get(start..end)
            .ok_or_else(|| format!("ends within {field}: {end} bytes are needed, {} are there", self.bytes.len()))?;
        self.at = end;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self, field: &str) -> Result<[u8; N], String> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N, N, field)?);
        if !self.little {
            array.reverse();
        }
        Ok(array)
    }

    pub(super) fn i32(&mut self, field: &str) -> Result<i32, String> {
        Ok(i32::from_le_bytes(self.array(field)?))
    }

    pub(super) fn u32(&mut self, field: &str) -> Result<u32, String> {
        Ok(u32::from_le_bytes(self.array(field)?))
    }

    pub(super) fn f32(&mut self, field: &str) -> Result<f32, String> {
        Ok(f32::from_le_bytes(self.array(field)?))
    }

    pub(super) fn f64(&mut self, field: &str) -> Result<f64, String> {
        Ok(f64::from_le_bytes(self.array(field)?))
    }

    /// The number of elements of a sequence, each of at least `size` bytes.
    pub(super) fn length(&mut self, size: usize, limit: usize, field: &str) -> Result<usize, String> {
        let count = self.u32(&format!("the length of {field}"))? as usize;
        if count > limit {
            return Err(format!("{field} has {count} elements, the limit is {limit}"));
        }
        let left = self.bytes.len() - self.at.min(self.bytes.len());
        if count.saturating_mul(size) > left {
            return Err(format!("{field} has {count} elements, {left} bytes are left for them"));
        }
        Ok(count)
    }

    pub(super) fn f32s(&mut self, limit: usize, field: &str) -> Result<Vec<f32>, String> {
        let count = self.length(4, limit, field)?;
        let mut values = Vec::with_capacity(count);
        for _ in 0..count {
            values.push(self.f32(field)?);
        }
        Ok(values)
    }

    /// A string, with its length in front and a zero at its end.
    pub(super) fn name(&mut self, field: &str) -> Result<&'a str, String> {
        let count = self.length(1, LONGEST_NAME, field)?;
        let bytes = self.take(count, 1, field)?;
        // Some writers leave the zero out of an empty one.
        let bytes = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        std::str::from_utf8(bytes).map_err(|_| format!("{field} is not text"))
    }
}
