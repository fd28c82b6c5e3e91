//! What changed since a revision: the recent commits of a map, and a watch that holds up nobody.
//!
//! The log is written before the root is published and read only up to a published revision, so whoever holds a root
//! finds every commit up to it. A watch is nothing but a place in the log: one that is slow finds several commits put
//! together. What the log has forgotten, also over a restart, the last changes of all blocks tell, which are kept with the
//! root and in the store.

use super::answers::{BlockChange, Changes, ChangesQuery, CommitNotice};
use super::failures::map_not_found;
use super::queries::{Area, QueryError, Root};
use super::registry::Entry;
use super::stamps::{BlockBox, bare};
use super::tasks::watch;
use super::{MapService, ServiceError, inline, metrics};
use crate::quadtree::{BlockAddress, LeafRange, NodeAddress};
use crate::store::{BlockStamp, MapId, MapName};
use crate::sync::{Mutex, MutexGuard};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, PoisonError};
use tokio::sync::broadcast;

/// Most cells that one answer holds: with them it stays below the 4 MiB that clients of gRPC take by default.
const MAX_CELLS: usize = 3 << 20;

/// Contents of more cells than these are read on a thread for it.
const INLINE_CELLS: usize = 65_536;

/// A watch of a box in which nothing changes is told of the map's revision this often, in commits, so that it can
/// resume from a revision that the log still reaches.
const QUIET_COMMITS: u64 = 256;

/// Notices of commits that wait for their listeners; a listener that falls behind is told so.
pub(super) const NOTICES: usize = 1024;

/// The recent commits of one map.
pub(super) struct ChangeLog {
    name: MapName,
    id: MapId,
    recent: Mutex<Recent>,
    revision: watch::Sender<u64>,
    notices: broadcast::Sender<CommitNotice>,
}

struct Recent {
    /// All commits after this revision are held.
    since: u64,
    commits: VecDeque<Logged>,
    /// Entries held: one a commit and one a block.
    held: usize,
    limit: usize,
}

#[derive(Clone)]
struct Logged {
    revision: u64,
    blocks: Arc<[BlockAddress]>,
}

impl ChangeLog {
    /// An empty log of a map at a revision, that holds at most `limit` changed blocks.
    pub(super) fn new(
        name: MapName,
        id: MapId,
        revision: u64,
        limit: usize,
        notices: broadcast::Sender<CommitNotice>,
    ) -> Self {
        let recent = Recent { since: revision, commits: VecDeque::new(), held: 0, limit };
        Self { name, id, recent: Mutex::new(recent), revision: watch::Sender::new(revision), notices }
    }

    fn recent(&self) -> MutexGuard<'_, Recent> {
        self.recent.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes a commit down. Called before its root is published.
    pub(super) fn record(&self, revision: u64, blocks: impl Iterator<Item = BlockAddress>) {
        let logged = Logged { revision, blocks: blocks.collect() };
        let mut recent = self.recent();
        recent.held += 1 + logged.blocks.len();
        recent.commits.push_back(logged);
        while recent.held > recent.limit
            && let Some(oldest) = recent.commits.pop_front()
        {
            recent.held -= 1 + oldest.blocks.len();
            recent.since = oldest.revision;
        }
    }

    /// Wakes those who watch. Called when the root is published.
    pub(super) fn announce(&self, revision: u64) {
        self.revision.send_replace(revision);
        // Nobody may be listening.
        let _ = self.notices.send(CommitNotice { name: self.name.clone(), id: self.id, revision });
    }

    /// The blocks changed after `since` up to `until`, each with the last commit that changed it, by Morton code;
    /// `None` when the log does not reach back.
    fn between(&self, since: u64, until: u64) -> Option<BTreeMap<u64, u64>> {
        let commits: Vec<Logged> = {
            let recent = self.recent();
            if since < recent.since || since > until {
                return None;
            }
            let after = recent.commits.partition_point(|commit| commit.revision <= since);
            recent.commits.range(after..).take_while(|commit| commit.revision <= until).cloned().collect()
        };
        let mut blocks = BTreeMap::new();
        for commit in commits {
            blocks.extend(commit.blocks.iter().map(|block| (block.morton(), commit.revision)));
        }
        Some(blocks)
    }
}

/// Commits of one map as they come. Dropping it ends it; it is a place in the map's log and costs the map nothing.
pub struct Watch {
    service: MapService,
    entry: Arc<Entry>,
    query: ChangesQuery,
    /// The revision that the reader was told of last.
    told: u64,
    /// Up to here the log was looked through; what lies between changed nothing that the reader asked for.
    seen: u64,
    begun: bool,
    revision: watch::Receiver<u64>,
    _counted: metrics::Watching,
}

impl Watch {
    /// The next answer: at once where the map stands when it is the first, then whenever something changed in the box
    /// that was asked for. What was committed since the last call is put together.
    ///
    /// # Errors
    /// [`super::ErrorKind::MapNotFound`] when the map is deleted; those of loading a map. No further answers follow.
    pub async fn next(&mut self) -> Result<Changes, ServiceError> {
        loop {
            self.revision.mark_unchanged();
            let root = self.service.root_of(&self.entry).await?;
            let revision = root.published.revision;
            if !self.begun || revision != self.seen {
                let seen = std::mem::replace(&mut self.seen, revision);
                let mut changes = self.service.changes_of(&self.entry, root, seen, &self.query).await?;
                if self.query.robots {
                    let robots = &self.entry.robots;
                    changes.robots = if self.begun { robots.moved(seen, revision) } else { robots.all(revision) };
                }
                let quiet = changes.blocks.is_empty() && changes.robots.is_empty() && !changes.everything;
                if !self.begun || !quiet || revision.saturating_sub(self.told) >= QUIET_COMMITS {
                    changes.since = self.told;
                    self.told = revision;
                    self.begun = true;
                    return Ok(changes);
                }
                continue;
            }
            tokio::select! {
                biased;
                () = self.entry.stop.cancelled() => return Err(map_not_found(self.entry.name())),
                changed = self.revision.changed() => {
                    if changed.is_err() {
                        return Err(map_not_found(self.entry.name()));
                    }
                }
            }
        }
    }
}

impl MapService {
    /// The blocks changed after a revision.
    ///
    /// # Errors
    /// [`super::ErrorKind::MapNotFound`], and those of a box query.
    pub async fn changes(&self, name: &MapName, since: u64, query: &ChangesQuery) -> Result<Changes, ServiceError> {
        let entry = self.registry.find(name)?;
        let root = self.root_of(&entry).await?;
        let mut changes = self.changes_of(&entry, root, since, query).await?;
        if query.robots {
            changes.robots = entry.robots.moved(since, changes.revision);
        }
        Ok(changes)
    }

    /// Changes after a revision (without one: those to come), as they are committed.
    ///
    /// # Errors
    /// As [`MapService::changes`].
    pub async fn watch(&self, name: &MapName, since: Option<u64>, query: ChangesQuery) -> Result<Watch, ServiceError> {
        let entry = self.registry.find(name)?;
        let root = self.root_of(&entry).await?;
        root.area(&query.area)?;
        let since = since.unwrap_or(root.published.revision);
        let revision = entry.changes.revision.subscribe();
        let service = self.clone();
        let counted = metrics::Watching::new();
        Ok(Watch { service, entry, query, told: since, seen: since, begun: false, revision, _counted: counted })
    }

    /// Tells of every commit of every map from now on.
    #[must_use]
    pub fn commits(&self) -> broadcast::Receiver<CommitNotice> {
        self.registry.notices.subscribe()
    }

    async fn changes_of(
        &self,
        entry: &Entry,
        root: Root,
        since: u64,
        query: &ChangesQuery,
    ) -> Result<Changes, ServiceError> {
        let area = root.area(&query.area)?;
        let contents = query.contents;
        if let Some(blocks) = entry.changes.between(since, root.published.revision) {
            let stamps = &root.published.stamps;
            let blocks = blocks.into_iter().map(|(code, revision)| {
                let block = BlockAddress::from_morton(code);
                let changed = stamps.get(block).map_or(0.0, |stamp| stamp.changed);
                (block, BlockStamp { revision, changed })
            });
            let plan = Plan::new(&root, &area, Some(blocks), contents);
            if plan.cells <= INLINE_CELLS
                && let Some(answer) = inline("changes", entry.name(), || plan.read(&root.in_memory(), since))
            {
                return answer;
            }
            return self.apart("changes", entry.name(), move || plan.read(&root, since)).await;
        }
        // What the log has forgotten, the last changes of all blocks tell.
        let answer = move || {
            let stamps = &root.published.stamps;
            let told = (stamps.complete_from()..=root.published.revision).contains(&since);
            Plan::new(&root, &area, told.then(|| stamps.since(since)), contents).read(&root, since)
        };
        self.apart("changes", entry.name(), answer).await
    }
}

/// Which nodes an answer names, before their contents are read.
struct Plan {
    /// Depth of the cells.
    depth: u8,
    /// Node and its last change; `None` when the reader must take everything anew.
    nodes: Option<Vec<(NodeAddress, BlockStamp)>>,
    /// Cells to read in all; 0 without contents.
    cells: usize,
    contents: bool,
}

impl Plan {
    /// `blocks` are those that changed; `None` when that cannot be told.
    fn new(
        root: &Root,
        area: &Area,
        blocks: Option<impl Iterator<Item = (BlockAddress, BlockStamp)>>,
        contents: bool,
    ) -> Self {
        let within = BlockBox::new(root.config.grid(), &area.leaves);
        let nodes = blocks.map(|blocks| within.nodes(area.depth, blocks));
        let side = 1_usize << (area.depth - within.node_depth(area.depth));
        let count = nodes.as_ref().map_or(0, Vec::len);
        let cells = if contents { count.saturating_mul(side * side) } else { 0 };
        // Too many cells for a message are everything too.
        let nodes = nodes.filter(|_| cells <= MAX_CELLS);
        Self { depth: area.depth, cells: if nodes.is_some() { cells } else { 0 }, nodes, contents }
    }

    fn read(&self, root: &Root, since: u64) -> Result<Changes, QueryError> {
        let everything = self.nodes.is_none();
        let block = |(node, stamp): (NodeAddress, BlockStamp)| {
            let side = 1_u32 << (self.depth - node.depth);
            let (left, bottom) = (node.x * side, node.y * side);
            let cells = LeafRange { min_x: left, min_y: bottom, max_x: left + side, max_y: bottom + side };
            let classes = if self.contents { root.tree.try_raster(&cells, self.depth)? } else { Vec::new() };
            Ok(BlockChange { classes, ..bare((node, stamp)) })
        };
        let blocks = self.nodes.iter().flatten().copied().map(block).collect::<Result<_, QueryError>>()?;
        let revision = root.published.revision;
        Ok(Changes { revision, since, everything, depth: self.depth, blocks, robots: Vec::new() })
    }
}
