//! Map files: what is written is read, and nothing that was cut or changed is.

use crate::store_support::{Model, assert_same, config, shapes};
use proptest::prelude::*;
use ubbmap::quadtree::{BlockAddress, BlockView, OccupancyTree};
use ubbmap::store::{MapFileError, MapFileLimits, read_map_file, read_map_file_within, write_map_file};

fn model(depth: u32, classes: u32, seed: u64, commits: usize) -> Model {
    let mut model = Model::new(config(depth, classes, 1 + (seed % 4) as usize), seed);
    for _ in 0..commits {
        model.step(5);
    }
    model
}

fn written(model: &Model) -> Vec<u8> {
    let mut file = Vec::new();
    write_map_file(&mut file, &model.config, &model.loaded()).unwrap();
    file
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn a_map_comes_back((depth, classes) in shapes(), seed: u64, commits in 0_usize..12) {
        let model = model(depth, classes, seed, commits);
        let file = written(&model);
        let (config, map) = read_map_file(&mut file.as_slice()).unwrap();
        prop_assert_eq!(&config, &model.config);
        assert_same(&map, &model.loaded());
        prop_assert_eq!(written(&model), file, "the same map gives the same bytes");
    }

    #[test]
    fn any_bytes_are_refused_without_a_panic(mut bytes: Vec<u8>, marked: bool) {
        if marked {
            bytes.splice(0..0, *b"\x89UBBMAP\n");
        }
        prop_assert!(read_map_file(&mut bytes.as_slice()).is_err());
    }

    /// A payload with sound checksums around anything: the parts are checked one by one.
    #[test]
    fn a_changed_payload_under_sound_checksums_never_panics(seed: u64, at in 0.0..1.0, byte: u8, cut: bool) {
        let file = written(&model(9, 10, seed, 4));
        let mut payload = zstd::decode_all(&file[40..]).unwrap();
        let place = (at * payload.len() as f64) as usize;
        if cut {
            payload.truncate(place);
        } else {
            payload[place] = byte;
        }
        let changed = sealed(1, &payload);
        if let Ok((config, map)) = read_map_file(&mut changed.as_slice()) {
            let mut again = Vec::new();
            write_map_file(&mut again, &config, &map).unwrap();
            // The count of windows and blocks apart, a payload has one form; blocks of class unknown are not written.
            let (config_again, map_again) = read_map_file(&mut again.as_slice()).unwrap();
            prop_assert_eq!(config, config_again);
            assert_same(&map_again, &map);
        }
    }
}

/// A file as `docs/store-format.md` says, by hand.
fn sealed(version: u32, payload: &[u8]) -> Vec<u8> {
    let compressed = zstd::encode_all(payload, 9).unwrap();
    let mut file = b"\x89UBBMAP\n".to_vec();
    file.extend_from_slice(&version.to_be_bytes());
    file.extend_from_slice(&(compressed.len() as u64).to_be_bytes());
    file.extend_from_slice(&crc32c::crc32c(&compressed).to_be_bytes());
    file.extend_from_slice(&(payload.len() as u64).to_be_bytes());
    file.extend_from_slice(&crc32c::crc32c(payload).to_be_bytes());
    file.extend_from_slice(&crc32c::crc32c(&file).to_be_bytes());
    file.extend_from_slice(&compressed);
    file
}

#[test]
fn every_cut_and_every_flipped_bit_is_refused() {
    let file = written(&model(8, 10, 3, 6));
    for length in 0..file.len() {
        let error = read_map_file(&mut &file[..length]).unwrap_err();
        let expected = match length {
            0..8 => "does not begin",
            8..40 => "within its header",
            _ => "cut",
        };
        assert!(error.to_string().contains(expected), "{length}: {error}");
    }
    for bit in 0..file.len() * 8 {
        let mut changed = file.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        let error = read_map_file(&mut changed.as_slice()).unwrap_err();
        let expected = if bit < 64 { "does not begin" } else { "checksum" };
        assert!(error.to_string().contains(expected), "bit {bit}: {error}");
    }
    let longer = [file.as_slice(), b"x"].concat();
    assert!(read_map_file(&mut longer.as_slice()).unwrap_err().to_string().contains("follows its end"));
}

#[test]
fn a_newer_file_is_refused_as_newer() {
    let file = sealed(2, b"whatever");
    let error = read_map_file(&mut file.as_slice()).unwrap_err();
    assert!(matches!(error, MapFileError::NewerFormat { found: 2, supported: 1 }), "{error}");
}

#[test]
fn a_small_file_of_a_map_too_large_is_refused() {
    let model = model(10, 10, 5, 30);
    let file = written(&model);
    let generous = MapFileLimits::default();
    let (mut uniform, mut mixed) = (0, 0);
    model.tree.visit_blocks(&mut |_, view| match view {
        BlockView::Uniform(_) => uniform += 1,
        BlockView::Mixed(_) => mixed += 1,
    });
    assert!(uniform > 0 && mixed > 0 && !model.windows.is_empty());
    let payload_bytes = zstd::decode_all(&file[40..]).unwrap().len() as u64;
    let exact = MapFileLimits {
        file_bytes: file.len() as u64 - 40,
        payload_bytes,
        uniform_blocks: uniform,
        mixed_blocks: mixed,
        windows: model.windows.len() as u64,
    };
    read_map_file_within(&mut file.as_slice(), &exact).unwrap();
    for limits in [
        MapFileLimits { file_bytes: exact.file_bytes - 1, ..generous },
        MapFileLimits { payload_bytes: payload_bytes - 1, ..generous },
        MapFileLimits { uniform_blocks: uniform - 1, ..generous },
        MapFileLimits { mixed_blocks: mixed - 1, ..generous },
        MapFileLimits { windows: exact.windows - 1, ..generous },
    ] {
        let error = read_map_file_within(&mut file.as_slice(), &limits).unwrap_err();
        assert!(matches!(error, MapFileError::TooLarge { .. }), "{error}");
    }
    // A hundred megabytes of zeros in a few kilobytes: not unpacked beyond what its parts need.
    let bomb = sealed(1, &vec![0; 100 << 20]);
    assert!(bomb.len() < 100_000);
    assert!(read_map_file(&mut bomb.as_slice()).is_err());
}

#[test]
fn a_map_beyond_the_limits_is_not_written() {
    let config = config(20, 10, 1);
    let mut tree = OccupancyTree::new(20, config.scale());
    // 2^12 x 2^10 blocks free: two thousand too many.
    for y in 0..1 << 10 {
        for x in 0..1 << 12 {
            tree.set_block(BlockAddress { x, y }, BlockView::Uniform(1));
        }
    }
    let map = ubbmap::store::LoadedMap { revision: 1, tree, windows: Default::default() };
    let mut file = Vec::new();
    let error = write_map_file(&mut file, &config, &map).unwrap_err();
    assert!(matches!(error, MapFileError::TooLarge { found: 4_194_304, .. }), "{error}");
    assert!(file.is_empty());
}

#[test]
fn a_writer_that_fails_is_told_of() {
    struct Full;
    impl std::io::Write for Full {
        fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
            Err(std::io::Error::other("no space"))
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let model = model(8, 10, 3, 2);
    let error = write_map_file(&mut Full, &model.config, &model.loaded()).unwrap_err();
    assert!(matches!(error, MapFileError::Io(_)) && error.to_string().contains("no space"), "{error}");
}
