//! A disk with a volatile cache, replayed: what files may hold after a power cut at any line of a recording.
//!
//! Sure is what a completed `fsync` or `fdatasync` of the same file covers, and, for names, one of their directory. All
//! that came later may be there or not: data by pages of 4 KiB, in any of the versions that a page had, also torn at a
//! sector; a file's length in any that it had; names of one directory in their order. Nothing else is assumed: syncing
//! a file does not make its name durable, and `sync_file_range` counts for nothing.

use crate::power_cut_trace::{Call, read};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::path::Path;

const PAGE: usize = 4096;
const SECTOR: usize = 512;

/// The end, without what was not done then.
const FINISHED: usize = usize::MAX - 1;

type NodeId = usize;

/// What one call changed.
#[derive(Debug)]
enum Change {
    Data { at: usize, bytes: Vec<u8> },
    Length(usize),
    Put(String, NodeId),
    Take(String),
    Move(String, String),
}

#[derive(Debug)]
struct Event {
    start: usize,
    end: usize,
    change: Change,
}

/// A file or directory: what it was at the beginning, and what happened to it.
#[derive(Debug, Default)]
struct Node {
    directory: bool,
    bytes: Vec<u8>,
    names: BTreeMap<String, NodeId>,
    events: Vec<Event>,
    /// Where each completed sync began and ended.
    syncs: Vec<(usize, usize)>,
}

/// How much of what is not sure survives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mood {
    Nothing,
    Everything,
    /// Each page by itself.
    Pages,
    /// The later ones without the earlier ones: caches write in any order.
    Later,
}

/// Everything that a process did to the files below a directory.
pub struct Recording {
    nodes: Vec<Node>,
    /// Lines: a cut is before one of them.
    pub lines: usize,
    /// Lines at which something began that changes files or syncs them.
    pub moments: Vec<usize>,
    /// Lines of the file of acknowledgements, and where the call that wrote each began.
    pub told: Vec<(usize, String)>,
}

/// While a recording is read: names as they are, and open files.
struct Reading<'a> {
    root: &'a str,
    /// The file of acknowledgements, in the root.
    acks: &'a str,
    out: Recording,
    now: HashMap<NodeId, BTreeMap<String, NodeId>>,
    open: HashMap<i64, (NodeId, usize)>,
    /// Contents of files as they are.
    live: HashMap<NodeId, Vec<u8>>,
    told: Vec<NodeId>,
}

impl Recording {
    /// Reads the log of a process that worked on the files below `root`. `before` has them as they were before it
    /// began, on the disk; `acks` is the name of the file in `root` in which it told what it had acknowledged.
    pub fn read(log: &Path, root: &Path, before: &Path, acks: &str) -> Self {
        let (calls, lines) = read(log);
        let out = Self { nodes: Vec::new(), lines, moments: Vec::new(), told: Vec::new() };
        let (now, open, live) = (HashMap::new(), HashMap::new(), HashMap::new());
        let root = root.to_str().unwrap();
        let mut reading = Reading { root, acks, out, now, open, live, told: Vec::new() };
        reading.load(before);
        // A number of an open file is free, and may be another file's, when its close begins.
        let mut order: Vec<&Call> = calls.iter().collect();
        order.sort_by_key(|call| if call.name == "close" { call.start } else { call.end });
        for call in order {
            reading.take(call);
        }
        reading.out.moments.sort_unstable();
        reading.out
    }

    /// Writes the files as they may be after a power cut before line `cut`.
    pub fn rebuild(&self, cut: usize, random: &mut ChaCha8Rng, into: &Path) {
        let mood = match random.random_range(0..6) {
            0 => Mood::Nothing,
            1 => Mood::Everything,
            2 => Mood::Later,
            _ => Mood::Pages,
        };
        self.rebuild_node(0, cut, mood, random, into);
    }

    /// Writes the files as they were when the process ended: with what it was at then, or without.
    pub fn rebuild_end(&self, unfinished: bool, random: &mut ChaCha8Rng, into: &Path) {
        let cut = if unfinished { usize::MAX } else { FINISHED };
        self.rebuild_node(0, cut, Mood::Everything, random, into);
    }

    fn rebuild_node(&self, id: NodeId, cut: usize, mood: Mood, random: &mut ChaCha8Rng, into: &Path) {
        let node = &self.nodes[id];
        if !node.directory {
            fs::write(into, node.bytes_after(cut, mood, random)).unwrap();
            return;
        }
        fs::create_dir_all(into).unwrap();
        for (name, child) in node.names_after(cut, mood, random) {
            self.rebuild_node(child, cut, mood, random, &into.join(name));
        }
    }
}

impl Node {
    /// Events that had begun at the cut; the first of them are sure.
    fn begun(&self, cut: usize) -> (Vec<&Event>, usize) {
        let covered = self.syncs.iter().filter(|(_, end)| *end < cut).map(|(start, _)| *start).max().unwrap_or(0);
        let mut begun: Vec<&Event> = self.events.iter().filter(|event| event.start < cut).collect();
        begun.retain(|event| event.end < usize::MAX || cut != FINISHED);
        begun.sort_by_key(|event| event.end);
        let sure = begun.iter().take_while(|event| event.end < covered).count();
        (begun, sure)
    }

    fn names_after(&self, cut: usize, mood: Mood, random: &mut ChaCha8Rng) -> BTreeMap<String, NodeId> {
        let (begun, sure) = self.begun(cut);
        let there = match mood {
            Mood::Nothing => sure,
            Mood::Everything => begun.len(),
            Mood::Pages | Mood::Later => random.random_range(sure..=begun.len()),
        };
        let mut names = self.names.clone();
        begun[..there].iter().for_each(|event| rename(&mut names, &event.change));
        names
    }

    fn bytes_after(&self, cut: usize, mood: Mood, random: &mut ChaCha8Rng) -> Vec<u8> {
        let (begun, sure) = self.begun(cut);
        let mut bytes = self.bytes.clone();
        for event in &begun[..sure] {
            write(&mut bytes, &event.change);
        }
        let mut newest = bytes.clone();
        let mut lengths = vec![bytes.len()];
        // By page: the number of the event, and the page after it.
        let mut versions: BTreeMap<usize, Vec<(usize, Vec<u8>)>> = BTreeMap::new();
        for (number, event) in begun[sure..].iter().enumerate() {
            for page in write(&mut newest, &event.change) {
                versions.entry(page).or_default().push((number, page_of(&newest, page)));
            }
            lengths.push(newest.len());
        }
        let length = match mood {
            Mood::Nothing => return bytes,
            Mood::Everything => return newest,
            _ if random.random_bool(0.5) => newest.len(),
            _ => lengths[random.random_range(0..lengths.len())],
        };
        bytes.resize(length, 0);
        let from = random.random_range(0..=begun.len() - sure);
        for (page, versions) in versions {
            let newest = versions.len() - 1;
            let chosen = match mood {
                Mood::Later => (versions[newest].0 >= from).then_some(newest),
                _ if random.random_bool(0.5) => None,
                _ if random.random_bool(0.75) => Some(newest),
                _ => Some(random.random_range(0..=newest)),
            };
            if let Some(chosen) = chosen {
                let torn = random.random_bool(1.0 / 16.0);
                let end = if torn { SECTOR * random.random_range(1..PAGE / SECTOR) } else { PAGE };
                let at = page * PAGE;
                let end = (at + end).min(length);
                if at < end {
                    bytes[at..end].copy_from_slice(&versions[chosen].1[..end - at]);
                }
            }
        }
        bytes
    }
}

/// Changes a file's bytes; the pages that changed.
fn write(bytes: &mut Vec<u8>, change: &Change) -> std::ops::Range<usize> {
    match change {
        Change::Data { at, bytes: new } => {
            let end = at + new.len();
            if bytes.len() < end {
                bytes.resize(end, 0);
            }
            bytes[*at..end].copy_from_slice(new);
            at / PAGE..end.div_ceil(PAGE)
        }
        Change::Length(length) => {
            let before = bytes.len();
            bytes.resize(*length, 0);
            length / PAGE..before.div_ceil(PAGE)
        }
        _ => 0..0,
    }
}

fn page_of(bytes: &[u8], page: usize) -> Vec<u8> {
    let mut copy = bytes.get(page * PAGE..).unwrap_or_default().iter().copied().take(PAGE).collect::<Vec<_>>();
    copy.resize(PAGE, 0);
    copy
}

fn rename(names: &mut BTreeMap<String, NodeId>, change: &Change) {
    match change {
        Change::Put(name, node) => drop(names.insert(name.clone(), *node)),
        Change::Take(name) => drop(names.remove(name)),
        Change::Move(from, to) => {
            if let Some(node) = names.remove(from) {
                names.insert(to.clone(), node);
            }
        }
        _ => {}
    }
}

impl Reading<'_> {
    fn load(&mut self, path: &Path) -> NodeId {
        let id = self.out.nodes.len();
        self.out.nodes.push(Node::default());
        if path.is_dir() {
            let entries = fs::read_dir(path).unwrap().map(Result::unwrap);
            let load = |entry: fs::DirEntry| (entry.file_name().into_string().unwrap(), self.load(&entry.path()));
            let names: BTreeMap<_, _> = entries.map(load).collect();
            self.now.insert(id, names.clone());
            self.out.nodes[id] = Node { directory: true, names, ..Node::default() };
        } else {
            let bytes = fs::read(path).unwrap();
            self.live.insert(id, bytes.clone());
            self.out.nodes[id].bytes = bytes;
        }
        id
    }

    /// The directory and the name of a path below the root; `None` for other paths.
    fn place(&self, call: &Call, directory: Option<usize>, path: usize) -> Option<(NodeId, String)> {
        let text = call.path(path);
        let (mut node, rest) = match directory.map(|argument| &call.arguments[argument]) {
            Some(fd) if !text.starts_with('/') && fd != "AT_FDCWD" => {
                (self.open.get(&fd.parse().ok()?)?.0, text.as_str())
            }
            _ => (0, text.strip_prefix(self.root)?.trim_start_matches('/')),
        };
        let mut parts: Vec<&str> = rest.split('/').filter(|part| !part.is_empty() && *part != ".").collect();
        let last = parts.pop().unwrap_or_default().to_owned();
        for part in parts {
            node = *self.now.get(&node)?.get(part)?;
        }
        Some((node, last))
    }

    fn find(&self, (directory, name): &(NodeId, String)) -> Option<NodeId> {
        if name.is_empty() { Some(*directory) } else { self.now.get(directory)?.get(name).copied() }
    }

    fn note(&mut self, call: &Call, node: NodeId, change: Change) {
        if let Some(names) = self.now.get_mut(&node) {
            rename(names, &change);
        }
        write(self.live.entry(node).or_default(), &change);
        self.out.moments.push(call.start);
        self.out.nodes[node].events.push(Event { start: call.start, end: call.end, change });
    }

    fn make(&mut self, directory: bool) -> NodeId {
        let id = self.out.nodes.len();
        self.out.nodes.push(Node { directory, ..Node::default() });
        if directory {
            self.now.insert(id, BTreeMap::new());
        }
        id
    }

    fn take(&mut self, call: &Call) {
        match call.name.as_str() {
            "open" => self.take_open(call, None),
            "openat" => self.take_open(call, Some(0)),
            "close" => drop(self.open.remove(&call.number(0))),
            "fcntl" if call.arguments[1].starts_with("F_DUPFD") => self.take_copy(call),
            "fcntl" => {}
            "rename" => self.take_rename(call, (None, 0), (None, 1)),
            "renameat" | "renameat2" => self.take_rename(call, (Some(0), 1), (Some(2), 3)),
            "unlink" | "rmdir" => self.take_unlink(call, None, 0),
            "unlinkat" => self.take_unlink(call, Some(0), 1),
            "mkdir" => self.take_mkdir(call, None, 0),
            "mkdirat" => self.take_mkdir(call, Some(0), 1),
            "openat2" | "creat" | "truncate" | "link" | "linkat" | "symlink" | "symlinkat" => {
                let concerned =
                    call.arguments.iter().any(|text| text.starts_with('"') && text.contains(&hex(self.root)));
                assert!(!concerned, "the replay does not know {call:?}");
            }
            "sync" | "syncfs" => panic!("the replay does not know {call:?}"),
            _ => self.take_of_file(call),
        }
    }

    fn take_open(&mut self, call: &Call, directory: Option<usize>) {
        self.open.remove(&call.result);
        let path = directory.map_or(0, |at| at + 1);
        let flags = &call.arguments[path + 1];
        let Some(place) = self.place(call, directory, path) else { return };
        let node = match self.find(&place) {
            Some(node) => node,
            None if flags.contains("O_CREAT") => {
                let node = self.make(false);
                self.note(call, place.0, Change::Put(place.1.clone(), node));
                if place.0 == 0 && place.1 == self.acks {
                    self.told.push(node);
                }
                node
            }
            None => return,
        };
        assert!(!["O_SYNC", "O_DSYNC", "O_DIRECT|", "O_APPEND"].iter().any(|flag| flags.contains(flag)), "{call:?}");
        if flags.contains("O_TRUNC") && self.live.get(&node).is_some_and(|bytes| !bytes.is_empty()) {
            self.note(call, node, Change::Length(0));
        }
        self.open.insert(call.result, (node, 0));
    }

    /// A copy of an open file's number. The two share one place in the file, which nothing here relies on.
    fn take_copy(&mut self, call: &Call) {
        match self.open.get(&call.number(0)).copied() {
            Some(open) => self.open.insert(call.result, open),
            None => self.open.remove(&call.result),
        };
    }

    fn take_rename(&mut self, call: &Call, from: (Option<usize>, usize), to: (Option<usize>, usize)) {
        match (self.place(call, from.0, from.1), self.place(call, to.0, to.1)) {
            (Some(from), Some(to)) => {
                assert_eq!(from.0, to.0, "the replay does not know renames from one directory to another: {call:?}");
                self.note(call, from.0, Change::Move(from.1, to.1));
            }
            (None, None) => {}
            _ => panic!("the replay does not know files that come from elsewhere: {call:?}"),
        }
    }

    fn take_unlink(&mut self, call: &Call, directory: Option<usize>, path: usize) {
        if let Some(place) = self.place(call, directory, path) {
            self.note(call, place.0, Change::Take(place.1));
        }
    }

    fn take_mkdir(&mut self, call: &Call, directory: Option<usize>, path: usize) {
        if let Some(place) = self.place(call, directory, path) {
            let node = self.make(true);
            self.note(call, place.0, Change::Put(place.1, node));
        }
    }

    /// A call whose first argument is an open file.
    fn take_of_file(&mut self, call: &Call) {
        let Some((node, at)) = self.open.get(&call.number(0)).copied() else {
            return self.check_copies(call);
        };
        let done = usize::try_from(call.result).unwrap();
        match call.name.as_str() {
            "copy_file_range" => self.take_range(call, done),
            "lseek" => drop(self.open.insert(call.number(0), (node, done))),
            "write" | "pwrite64" => {
                let mut bytes = call.bytes(1);
                bytes.truncate(done);
                if self.told.contains(&node) {
                    let text = String::from_utf8(bytes).unwrap();
                    self.out.told.extend(text.lines().map(|line| (call.start, line.to_owned())));
                    return;
                }
                let placed = call.name == "pwrite64";
                let at = if placed { usize::try_from(call.number(3)).unwrap() } else { at };
                if !placed {
                    self.open.insert(call.number(0), (node, at + done));
                }
                self.note(call, node, Change::Data { at, bytes });
            }
            "ftruncate" => self.note(call, node, Change::Length(usize::try_from(call.number(1)).unwrap())),
            "fsync" | "fdatasync" => {
                self.out.moments.push(call.start);
                self.out.nodes[node].syncs.push((call.start, call.end));
            }
            _ => panic!("the replay does not know {call:?}"),
        }
    }

    /// A copy from one watched file to another, from where both are.
    fn take_range(&mut self, call: &Call, done: usize) {
        let known = call.arguments[1] == "NULL" && call.arguments[3] == "NULL";
        let (from, from_at) = self.open[&call.number(0)];
        let to = self.open.get(&call.number(2)).copied().filter(|_| known);
        let (to, at) = to.unwrap_or_else(|| panic!("the replay does not know {call:?}"));
        let mut bytes: Vec<u8> = self.live[&from].iter().skip(from_at).take(done).copied().collect();
        // sled changes the length of its file by several threads at the same time: the shortest may be the last one
        // recorded, and what is beyond it is zeros.
        bytes.resize(done, 0);
        self.open.insert(call.number(0), (from, from_at + done));
        self.open.insert(call.number(2), (to, at + done));
        self.note(call, to, Change::Data { at, bytes });
    }

    /// Data can come into a watched file by a call whose first argument is another.
    fn check_copies(&self, call: &Call) {
        if ["copy_file_range", "sendfile", "splice"].contains(&call.name.as_str()) {
            let watched = call.arguments.iter().any(|text| text.parse().is_ok_and(|fd| self.open.contains_key(&fd)));
            assert!(!watched, "the replay does not know {call:?}");
        }
    }
}

fn hex(text: &str) -> String {
    text.bytes().map(|byte| format!("\\x{byte:02x}")).collect()
}
