//! Queries of one revision of a map: its last, or that of a snapshot.

use super::queries::Root;
use super::registry::{Entry, blocking};
use super::snapshot_cache::loaded_as_root;
use super::transfer::named;
use super::{
    BoxQuery, ClassesAnswer, ErrorKind, FreeAnswers, MapService, Raster, RegionAnswer, ServiceError, failures, inline,
    limited, setting,
};
use crate::mapping::Region;
use crate::store::{MapName, SnapshotName, StoreError};
use std::sync::Arc;

/// Queries of at most so many points are answered on the caller's thread, larger ones on a thread for them.
const INLINE_POINTS: usize = 1024;

/// The same for leaves of a region.
const INLINE_LEAVES: u64 = 4096;

/// The same for cells of a grid: a tile's.
const INLINE_CELLS: u64 = 65_536;

/// One revision of a map, to be asked as often as one likes.
pub struct MapView {
    service: MapService,
    name: MapName,
    root: Root,
}

impl MapService {
    /// A map as it is now, or as a snapshot keeps it, for which the map itself need not be readable. A snapshot is read as
    /// a whole the first time, and kept in memory under `cache.snapshot_bytes`.
    ///
    /// # Errors
    /// [`ErrorKind::MapNotFound`], [`ErrorKind::SnapshotNotFound`] at `snapshot`, [`ErrorKind::MapDamaged`].
    pub async fn view(&self, name: &MapName, snapshot: Option<&SnapshotName>) -> Result<MapView, ServiceError> {
        let entry = self.registry.find(name)?;
        let root = match snapshot {
            None => self.root_of(&entry).await?,
            Some(snapshot) => self.snapshot_root(&entry, snapshot).await.map_err(|error| named(error, "snapshot"))?,
        };
        Ok(MapView { service: self.clone(), name: name.clone(), root })
    }

    async fn snapshot_root(&self, entry: &Entry, snapshot: &SnapshotName) -> Result<Root, ServiceError> {
        let (store, id, map) = (Arc::clone(&self.registry.store), entry.id, entry.name());
        let listed = blocking(move || store.snapshots(id)).await?;
        let listed = listed.map_err(|error| failures::store_failure(map, "list the snapshots of", &error))?;
        // What it keeps is known by its revision: a name can be given anew.
        let Some(stored) = listed.into_iter().find(|stored| stored.name == *snapshot) else {
            return Err(failures::store_failure(map, "read", &StoreError::NoSnapshot(snapshot.clone())));
        };
        let (cache, config) = (&self.registry.snapshots, entry.config.load_full());
        if let Some(found) = cache.find(id, stored.revision) {
            return Ok(loaded_as_root(id, config, found));
        }
        // One at a time, whoever asks: who waited finds what another has read. The semaphore is never closed.
        let turn = Arc::clone(&cache.reading).acquire_owned().await.ok();
        if let Some(found) = cache.find(id, stored.revision) {
            return Ok(loaded_as_root(id, config, found));
        }
        let (registry, map_name, name) = (Arc::clone(&self.registry), map.clone(), stored.name);
        // It is read to its end and kept when the caller leaves, so that a large one is there when it is asked for again.
        let read = move || {
            let _turn = turn;
            let loaded = registry.store.load_snapshot(id, &name).map_err(super::queries::QueryError::Store)?;
            let kept = registry.snapshots.keep(id, loaded);
            // Who deletes a map takes it out of the table and then its snapshots from the cache: one of the two sees this.
            if !registry.find(&map_name).is_ok_and(|entry| entry.id == id) {
                registry.snapshots.forget(id);
            }
            Ok(kept)
        };
        Ok(loaded_as_root(id, config, self.apart("snapshot", map, read).await?))
    }
}

impl MapView {
    /// The revision that is read.
    #[must_use]
    pub fn revision(&self) -> u64 {
        self.root.published.revision
    }

    /// Classes at points; `depth` 0..=map depth, default the map's.
    ///
    /// # Errors
    /// [`ErrorKind::DepthOutOfRange`], [`ErrorKind::InvalidPoint`], [`ErrorKind::TooManyPoints`].
    pub async fn classes(self, points: &[(f64, f64)], depth: Option<u32>) -> Result<ClassesAnswer, ServiceError> {
        let Self { service, name, root } = self;
        limited(
            "points",
            points.len(),
            service.settings().max_points,
            ErrorKind::TooManyPoints,
            setting::POINTS_PER_QUERY,
        )?;
        let depth = root.depth(depth)?;
        if points.len() <= INLINE_POINTS
            && let Some(answer) = inline("classes", &name, || root.in_memory().classes(points, depth))
        {
            return answer;
        }
        let points = points.to_vec();
        service.apart("classes", &name, move || root.classes(&points, depth)).await
    }

    /// The quadtree leaves of a half-open box, at most to a depth; `with_blocks`: with the blocks that ever changed, and
    /// when they last did, which snapshots do not tell.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidRegion`], [`ErrorKind::RegionTooLarge`] naming the limit and the depth that would fit.
    pub async fn region(self, query: &BoxQuery, with_blocks: bool) -> Result<RegionAnswer, ServiceError> {
        let Self { service, name, root } = self;
        let area = root.area(query)?;
        if root.nodes(&area) <= INLINE_LEAVES
            && let Some(answer) =
                inline("region", &name, || root.in_memory().region(&area, with_blocks, service.settings()))
        {
            return answer;
        }
        let settings = Arc::clone(&service.registry.settings);
        service.apart("region", &name, move || root.region(&area, with_blocks, &settings)).await
    }

    /// A dense raster of a half-open box at a depth; cells outside the root are not in it.
    ///
    /// # Errors
    /// As [`MapView::region`].
    pub async fn grid(self, query: &BoxQuery) -> Result<Raster, ServiceError> {
        let Self { service, name, root } = self;
        let area = root.area(query)?;
        let plan = root.plan_grid(&area, service.settings())?;
        if root.nodes(&area) <= INLINE_CELLS
            && let Some(answer) = inline("grid", &name, || root.in_memory().grid_raster(&plan))
        {
            return answer;
        }
        service.apart("grid", &name, move || root.grid_raster(&plan)).await
    }

    /// The node `(z, x, y)` as 256 x 256 cells of depth `z + 8` (cells deeper than the leaves repeat the leaf).
    ///
    /// # Errors
    /// [`ErrorKind::TileOutOfRange`]
    pub async fn tile(self, z: u32, x: u32, y: u32) -> Result<Raster, ServiceError> {
        let Self { service, name, root } = self;
        if let Some(answer) = inline("tile", &name, || root.in_memory().tile(z, x, y)) {
            return answer;
        }
        service.apart("tile", &name, move || root.tile(z, x, y)).await
    }

    /// Is each region guaranteed free?
    ///
    /// # Errors
    /// [`ErrorKind::ToleranceTooHigh`], [`ErrorKind::TooManyRegions`].
    pub async fn guaranteed_free(self, regions: &[Region], tolerance: u32) -> Result<FreeAnswers, ServiceError> {
        let Self { service, name, root } = self;
        limited(
            "regions",
            regions.len(),
            service.settings().max_regions,
            ErrorKind::TooManyRegions,
            setting::REGIONS_PER_QUERY,
        )?;
        let tolerance = root.tolerance(tolerance)?;
        // How long a region takes depends on the map below it, so none of them is computed here.
        let regions = regions.to_vec();
        service.apart("guaranteed_free", &name, move || root.guaranteed_free(&regions, tolerance)).await
    }
}
