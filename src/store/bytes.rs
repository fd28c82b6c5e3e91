//! Plain big-endian fields: how every number and name is written on disk.

use thiserror::Error;

/// Why bytes are not what they should be; says which field.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{0}")]
pub(super) struct Malformed(pub(super) String);

impl Malformed {
    pub(super) fn new(why: impl Into<String>) -> Self {
        Self(why.into())
    }
}

/// Appends a float's bits, big-endian.
pub(super) fn put_f64(out: &mut Vec<u8>, value: f64) {
    out.extend_from_slice(&value.to_bits().to_be_bytes());
}

/// Appends a name of at most 255 bytes behind its length.
pub(super) fn put_name(out: &mut Vec<u8>, name: &str) {
    debug_assert!(name.len() <= 255, "names are at most 63 bytes long");
    let length = u8::try_from(name.len()).unwrap_or(u8::MAX);
    out.push(length);
    out.extend_from_slice(&name.as_bytes()[..usize::from(length)]);
}

/// Takes fields from the front of a slice.
pub(super) struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    /// The next `count` bytes.
    pub(super) fn take(&mut self, count: usize, field: &str) -> Result<&'a [u8], Malformed> {
        let (head, rest) = self
            .rest
            .split_at_checked(count)
            .ok_or_else(|| Malformed(format!("{field}: {count} bytes wanted, {} left", self.rest.len())))?;
        self.rest = rest;
        Ok(head)
    }

    /// All that is left.
    pub(super) fn rest(self) -> &'a [u8] {
        self.rest
    }

    fn array<const N: usize>(&mut self, field: &str) -> Result<[u8; N], Malformed> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N, field)?);
        Ok(array)
    }

    pub(super) fn u8(&mut self, field: &str) -> Result<u8, Malformed> {
        self.array::<1>(field).map(|[byte]| byte)
    }

    pub(super) fn u32(&mut self, field: &str) -> Result<u32, Malformed> {
        self.array(field).map(u32::from_be_bytes)
    }

    pub(super) fn u64(&mut self, field: &str) -> Result<u64, Malformed> {
        self.array(field).map(u64::from_be_bytes)
    }

    pub(super) fn f64(&mut self, field: &str) -> Result<f64, Malformed> {
        self.u64(field).map(f64::from_bits)
    }

    /// A flag: 0 or 1 and nothing else, so that a value has one form.
    pub(super) fn flag(&mut self, field: &str) -> Result<bool, Malformed> {
        match self.u8(field)? {
            0 => Ok(false),
            1 => Ok(true),
            other => Err(Malformed(format!("{field}: a flag must be 0 or 1, found {other}"))),
        }
    }

    pub(super) fn name(&mut self, field: &str) -> Result<&'a str, Malformed> {
        let length = usize::from(self.u8(field)?);
        std::str::from_utf8(self.take(length, field)?).map_err(|_| Malformed(format!("{field}: not UTF-8")))
    }

    /// Nothing may be left.
    pub(super) fn end(self) -> Result<(), Malformed> {
        if self.rest.is_empty() { Ok(()) } else { Err(Malformed(format!("{} bytes too many", self.rest.len()))) }
    }
}
