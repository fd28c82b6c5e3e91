//! Lines of a plain or gzip source, of bounded length.

use super::LogError;
use flate2::bufread::MultiGzDecoder;
use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];

/// Reads lines one after the other into one buffer.
pub(super) struct Lines {
    source: Box<dyn BufRead + Send>,
    buffer: Vec<u8>,
    number: u64,
    max_line_bytes: usize,
    bytes_read: Arc<AtomicU64>,
    /// A failure met while the source was told apart; reported with the first line.
    failed: Option<std::io::Error>,
}

/// Counts what passes through.
struct Counted<R> {
    inner: R,
    bytes_read: Arc<AtomicU64>,
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, into: &mut [u8]) -> std::io::Result<usize> {
        let count = self.inner.read(into)?;
        self.bytes_read.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }
}

impl Lines {
    /// Looks at the first two bytes: gzip or plain.
    pub(super) fn new(source: impl Read + Send + 'static, max_line_bytes: usize) -> Self {
        let bytes_read = Arc::new(AtomicU64::new(0));
        let counted = Counted { inner: source, bytes_read: Arc::clone(&bytes_read) };
        let (source, failed) = open(counted);
        Self { source, buffer: Vec::new(), number: 0, max_line_bytes, bytes_read, failed }
    }

    /// Number of the line read last, 0 before the first.
    pub(super) fn number(&self) -> u64 {
        self.number
    }

    pub(super) fn bytes_read(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.bytes_read)
    }

    /// The next line and its number, without its end; `None` at the end.
    pub(super) fn next_line(&mut self) -> Result<Option<(u64, &str)>, LogError> {
        if let Some(source) = self.failed.take() {
            return Err(LogError::Read { line: 0, source });
        }
        self.buffer.clear();
        let limit = self.max_line_bytes as u64 + 1;
        let count = match (&mut self.source).take(limit).read_until(b'\n', &mut self.buffer) {
            Ok(count) => count,
            // A plain file does not end unexpectedly, so this is a gzip stream cut short.
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => {
                return Err(LogError::Truncated { line: self.number });
            }
            Err(source) => return Err(LogError::Read { line: self.number, source }),
        };
        if count == 0 {
            return Ok(None);
        }
        self.number += 1;
        if self.buffer.last() == Some(&b'\n') {
            self.buffer.pop();
        } else if count > self.max_line_bytes {
            let problem = format!("is longer than {} bytes", self.max_line_bytes);
            return Err(LogError::Line { line: self.number, problem });
        }
        match std::str::from_utf8(&self.buffer) {
            Ok(text) => Ok(Some((self.number, text))),
            Err(error) => {
                let problem = format!("is not text: byte {} is not UTF-8", error.valid_up_to() + 1);
                Err(LogError::Line { line: self.number, problem })
            }
        }
    }
}

fn open(source: impl Read + Send + 'static) -> (Box<dyn BufRead + Send>, Option<std::io::Error>) {
    let mut source = BufReader::with_capacity(1 << 16, source);
    // A read may give one byte alone: the magic is gathered byte by byte and put back in front.
    let mut head = Vec::new();
    let failed = (&mut source).take(GZIP_MAGIC.len() as u64).read_to_end(&mut head).err();
    let gzip = head == GZIP_MAGIC;
    let whole = BufReader::with_capacity(1 << 16, std::io::Cursor::new(head).chain(source));
    if gzip {
        (Box::new(BufReader::with_capacity(1 << 16, MultiGzDecoder::new(whole))), failed)
    } else {
        (Box::new(whole), failed)
    }
}
