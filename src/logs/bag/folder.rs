//! The files of a bag: one, or those of a folder with its `metadata.yaml`.

use super::file::{MCAP_MAGIC, SQLITE_MAGIC, ZSTD_MAGIC, head};
use std::path::{Component, Path, PathBuf};

/// What a folder's list of files is named.
const METADATA: &str = "metadata.yaml";

/// Longest list, bytes.
const LONGEST_METADATA: u64 = 16 << 20;

/// Is this a bag, a file of one or a folder? What cannot be read is none.
pub(in crate::logs) fn is_bag(path: &Path) -> bool {
    if path.is_dir() {
        return true;
    }
    head(path).is_ok_and(|head| {
        head.starts_with(&MCAP_MAGIC) || head.starts_with(&SQLITE_MAGIC) || head.starts_with(&ZSTD_MAGIC)
    })
}

/// The files of a bag in the order of their recording.
///
/// # Errors
/// A sentence for a folder that is no bag.
pub(super) fn files(path: &Path) -> Result<Vec<PathBuf>, String> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let metadata = path.join(METADATA);
    if metadata.is_file() {
        let size = metadata.metadata().map_err(|error| error.to_string())?.len();
        if size > LONGEST_METADATA {
            return Err(format!("its {METADATA} has {size} bytes, the limit is {LONGEST_METADATA}"));
        }
        let text = std::fs::read_to_string(&metadata).map_err(|error| format!("{METADATA}: {error}"))?;
        let names = listed(&text);
        if !names.is_empty() {
            return names.into_iter().map(|name| of_folder(path, &name)).collect();
        }
    }
    let mut found = Vec::new();
    for entry in std::fs::read_dir(path).map_err(|error| error.to_string())? {
        let entry = entry.map_err(|error| error.to_string())?.path();
        let name = entry.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if [".mcap", ".mcap.zstd", ".db3"].iter().any(|end| name.ends_with(end)) {
            found.push(entry);
        }
    }
    if found.is_empty() {
        return Err(format!(
            "is a folder without a {METADATA} that lists files, and without a .mcap or .db3 file: no bag"
        ));
    }
    found.sort_by_key(|file| by_number(file));
    Ok(found)
}

/// A file that a list names: within the folder.
fn of_folder(folder: &Path, name: &str) -> Result<PathBuf, String> {
    let relative = Path::new(name);
    if relative.components().any(|part| !matches!(part, Component::Normal(_) | Component::CurDir)) {
        return Err(format!("its {METADATA} names {name:?}, which is not in the folder"));
    }
    let file = folder.join(relative);
    // Some recorders list the folder's name in front.
    let beside = folder.parent().map(|parent| parent.join(relative));
    if !file.is_file() && beside.as_ref().is_some_and(|beside| beside.is_file()) {
        return Ok(beside.unwrap_or(file));
    }
    if !file.is_file() {
        return Err(format!("its {METADATA} names {name:?}, which is not there"));
    }
    Ok(file)
}

/// The names under `relative_file_paths`. The file is YAML, of which recorders write one plain form here.
fn listed(text: &str) -> Vec<String> {
    let behind = text.lines().skip_while(|line| line.trim() != "relative_file_paths:").skip(1);
    let items = behind.map_while(|line| line.trim_start().strip_prefix("- "));
    items.map(|item| item.trim().trim_matches(['"', '\'']).to_owned()).filter(|item| !item.is_empty()).collect()
}

/// `name_2` before `name_10`.
fn by_number(file: &Path) -> (String, u64, PathBuf) {
    let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let stem = name.split('.').next().unwrap_or_default();
    let digits = stem.len() - stem.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    let (front, number) = stem.split_at(stem.len() - digits);
    (front.to_owned(), number.parse().unwrap_or(0), file.to_owned())
}
