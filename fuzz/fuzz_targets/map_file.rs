//! Map files. The first byte chooses: the bytes as a file, or as a payload in a frame whose checksums are right, so that
//! what is behind them is reached. What is read is written as a file that is read as the same map.
#![no_main]

use libfuzzer_sys::fuzz_target;
use ubbmap::store::{MapFileLimits, read_map_file_within, write_map_file};

fn limits() -> MapFileLimits {
    MapFileLimits { payload_bytes: 1 << 20, uniform_blocks: 4096, mixed_blocks: 256, ..MapFileLimits::default() }
}

fn framed(payload: &[u8]) -> Vec<u8> {
    let compressed = zstd::bulk::compress(payload, 1).expect("bytes are compressed");
    let mut file = b"\x89UBBMAP\n".to_vec();
    file.extend_from_slice(&1_u32.to_be_bytes());
    file.extend_from_slice(&(compressed.len() as u64).to_be_bytes());
    file.extend_from_slice(&crc32c::crc32c(&compressed).to_be_bytes());
    file.extend_from_slice(&(payload.len() as u64).to_be_bytes());
    file.extend_from_slice(&crc32c::crc32c(payload).to_be_bytes());
    let sum = crc32c::crc32c(&file);
    file.extend_from_slice(&sum.to_be_bytes());
    file.extend_from_slice(&compressed);
    file
}

fuzz_target!(|bytes: &[u8]| {
    let Some((which, bytes)) = bytes.split_first() else { return };
    let file = if which % 8 == 0 { bytes.to_vec() } else { framed(bytes) };
    let Ok((config, map)) = read_map_file_within(&mut file.as_slice(), &limits()) else { return };
    let mut written = Vec::new();
    write_map_file(&mut written, &config, &map).expect("a map that was read is written");
    let (config_again, map_again) =
        read_map_file_within(&mut written.as_slice(), &limits()).expect("what was written is read");
    assert!(config == config_again && map.revision == map_again.revision && map.windows == map_again.windows);
    let mut again = Vec::new();
    write_map_file(&mut again, &config_again, &map_again).expect("a map that was read is written");
    assert!(written == again, "the same map was written as other bytes");
});
