//! Queries of one published root: plain functions that wait for nothing but the blocks that they look into.

use super::stamps::{BlockBox, bare, time_of};
use super::writer::Published;
use super::{
    BoxQuery, ClassesAnswer, ErrorKind, FreeAnswers, Raster, RegionAnswer, ServiceError, ServiceSettings, setting,
};
use crate::mapping::{EvidenceRule, MapConfig, Region, try_guaranteed_free};
use crate::quadtree::{Class, Grid, Leaf, LeafRange, NodeAddress, PageError, PagedTree};
use crate::store::{MapId, StoreError};
use std::sync::Arc;

/// Levels between a tile's node and its cells: 256 cells a side.
const TILE_LEVELS: u8 = 8;

/// Cells along one side of a tile.
const TILE_SIDE: u32 = 1 << TILE_LEVELS;

/// What one query reads: a map's configuration and one revision.
#[derive(Clone)]
pub(super) struct Root {
    pub(super) id: MapId,
    pub(super) config: Arc<MapConfig>,
    pub(super) published: Arc<Published>,
    /// The published tree; for an answer that must not wait for a disk, one that fetches nothing.
    pub(super) tree: PagedTree,
}

/// Why a query has no answer.
#[derive(Debug)]
pub(super) enum QueryError {
    /// A block is not in memory, and the root was one that fetches nothing: the query is to be asked elsewhere.
    Absent,
    /// A block cannot be read.
    Store(StoreError),
    /// The query itself.
    Refused(ServiceError),
}

impl From<ServiceError> for QueryError {
    fn from(error: ServiceError) -> Self {
        Self::Refused(error)
    }
}

impl From<PageError> for QueryError {
    fn from(error: PageError) -> Self {
        if matches!(error, PageError::Absent) { Self::Absent } else { Self::Store(error.into()) }
    }
}

/// A box query checked against the map: its depth and its leaves.
#[derive(Debug, Clone, Copy)]
pub(super) struct Area {
    pub(super) depth: u8,
    pub(super) leaves: LeafRange,
}

/// A raster whose cells are known but not yet read.
#[derive(Debug, Clone, Copy)]
pub(super) struct RasterPlan {
    /// Depth of the cells.
    depth: u8,
    /// Columns and rows, in cells of `depth`.
    range: LeafRange,
}

impl Area {
    /// The nodes of `depth` that have interior in common with the box; empty if the box is.
    fn nodes(&self, map_depth: u8, depth: u8) -> LeafRange {
        let shift = map_depth - depth;
        let r = &self.leaves;
        if r.is_empty() {
            let (x, y) = (r.min_x >> shift, r.min_y >> shift);
            return LeafRange { min_x: x, min_y: y, max_x: x, max_y: y };
        }
        let behind = |max: u32| ((max - 1) >> shift) + 1;
        LeafRange { min_x: r.min_x >> shift, min_y: r.min_y >> shift, max_x: behind(r.max_x), max_y: behind(r.max_y) }
    }

    /// Number of nodes of `depth`.
    fn count(&self, map_depth: u8, depth: u8) -> u64 {
        let nodes = self.nodes(map_depth, depth);
        u64::from(nodes.max_x - nodes.min_x) * u64::from(nodes.max_y - nodes.min_y)
    }
}

impl Root {
    /// The same root, read without fetching anything.
    pub(super) fn in_memory(&self) -> Self {
        Self { tree: self.tree.in_memory(), ..self.clone() }
    }

    fn grid(&self) -> &Grid {
        self.config.grid()
    }

    /// The depth asked for, the map's by default.
    pub(super) fn depth(&self, asked: Option<u32>) -> Result<u8, ServiceError> {
        checked_depth(self.grid(), asked)
    }

    /// Classes at points, by the half-open cells of `depth`.
    pub(super) fn classes(&self, points: &[(f64, f64)], depth: u8) -> Result<ClassesAnswer, QueryError> {
        let shift = self.grid().depth() - depth;
        let unknown = self.config.scale().unknown();
        let class = |(index, (x, y)): (usize, &(f64, f64))| {
            for (axis, value) in [("x", x), ("y", y)] {
                if !value.is_finite() {
                    let detail = format!("points[{index}].{axis} is not a finite number: {value}");
                    let error = ServiceError::new(ErrorKind::InvalidPoint, detail);
                    return Err(error.at(format!("points[{index}].{axis}")).into());
                }
            }
            let Some(leaf) = self.grid().leaf_at(*x, *y) else { return Ok(unknown) };
            Ok(self.tree.try_max_class(NodeAddress { depth, x: leaf.x >> shift, y: leaf.y >> shift })?)
        };
        let classes: Result<Vec<Class>, QueryError> = points.iter().enumerate().map(class).collect();
        Ok(ClassesAnswer { revision: self.published.revision, depth, classes: classes? })
    }

    /// Checks a box query.
    pub(super) fn area(&self, query: &BoxQuery) -> Result<Area, ServiceError> {
        let depth = self.depth(query.depth)?;
        let bounds = self.grid().bounds();
        let x = axis("x", query.min_x, query.max_x, (bounds.x.lo(), bounds.x.hi()))?;
        let y = axis("y", query.min_y, query.max_y, (bounds.y.lo(), bounds.y.hi()))?;
        let empty = LeafRange { min_x: 0, min_y: 0, max_x: 0, max_y: 0 };
        let leaves = match (x, y) {
            (Some(x), Some(y)) => self.grid().leaves_within(x.0, y.0, x.1, y.1),
            _ => empty,
        };
        Ok(Area { depth, leaves: if leaves.is_empty() { empty } else { leaves } })
    }

    /// Number of nodes of an area at its depth: no answer has more leaves or cells.
    pub(super) fn nodes(&self, area: &Area) -> u64 {
        area.count(self.grid().depth(), area.depth)
    }

    /// Leaves of an area in Z-order, with its blocks where they are wanted.
    pub(super) fn region(
        &self,
        area: &Area,
        with_blocks: bool,
        settings: &ServiceSettings,
    ) -> Result<RegionAnswer, QueryError> {
        let limit = settings.max_leaves;
        let mut leaves = Vec::new();
        if self.visit(area, area.depth, limit, &mut |leaf| leaves.push(leaf))? {
            let within = BlockBox::new(self.grid(), &area.leaves);
            let changed = within.changed(&self.published.stamps);
            let last_change = changed.iter().map(|(_, stamp)| *stamp).max_by_key(|stamp| stamp.revision);
            let wanted = if with_blocks { changed } else { Vec::new() };
            let blocks: Vec<_> = within.nodes(area.depth, wanted).into_iter().map(bare).collect();
            let last_change = last_change.and_then(time_of);
            let answer =
                RegionAnswer { revision: self.published.revision, depth: area.depth, leaves, last_change, blocks };
            if answer.blocks.len() <= limit {
                return Ok(answer);
            }
            let what = format!("the region has {} blocks that changed, the limit is {limit}", answer.blocks.len());
            let error = ServiceError::over(ErrorKind::RegionTooLarge, setting::LEAVES_PER_ANSWER, what);
            return Err(error.at("blocks").into());
        }
        drop(leaves);
        // A coarser reading never has more leaves, so the deepest that fits is found by halving; each trial stops at
        // the limit.
        let (mut fits, mut too_deep) = (None, area.depth);
        let mut low = 0;
        while low < too_deep {
            let middle = low + (too_deep - low) / 2;
            if self.visit(area, middle, limit, &mut |_| ())? {
                fits = Some(middle);
                low = middle + 1;
            } else {
                too_deep = middle;
            }
        }
        let what = format!("the region has more than {limit} leaves at depth {}, which is the limit", area.depth);
        Err(too_large(setting::LEAVES_PER_ANSWER, &what, fits).into())
    }

    /// Visits leaves until there are more than `limit`; false when there are.
    fn visit(&self, area: &Area, depth: u8, limit: usize, visitor: &mut dyn FnMut(Leaf)) -> Result<bool, PageError> {
        let mut count = 0;
        self.tree.try_visit_leaves(&area.leaves, depth, &mut |leaf| {
            count += 1;
            if count <= limit {
                visitor(leaf);
            }
            count <= limit
        })
    }

    /// Checks the size of a raster of an area.
    pub(super) fn plan_grid(&self, area: &Area, settings: &ServiceSettings) -> Result<RasterPlan, ServiceError> {
        let map_depth = self.grid().depth();
        let limit = settings.max_cells as u64;
        let range = area.nodes(map_depth, area.depth);
        if area.count(map_depth, area.depth) <= limit {
            return Ok(RasterPlan { depth: area.depth, range });
        }
        let fits = (0..area.depth).rev().find(|depth| area.count(map_depth, *depth) <= limit);
        let (width, height) = (range.max_x - range.min_x, range.max_y - range.min_y);
        let what = format!("the grid has {width} x {height} cells at depth {}, the limit is {limit}", area.depth);
        Err(too_large(setting::CELLS_PER_ANSWER, &what, fits))
    }

    /// Reads a raster.
    pub(super) fn grid_raster(&self, plan: &RasterPlan) -> Result<Raster, QueryError> {
        let RasterPlan { depth, range } = *plan;
        let classes = self.tree.try_raster(&range, depth)?;
        let size = (range.max_x - range.min_x, range.max_y - range.min_y);
        Ok(self.raster(depth, range.min_x, range.min_y, size, classes))
    }

    /// The node `(z, x, y)` as 256 x 256 cells.
    pub(super) fn tile(&self, z: u32, x: u32, y: u32) -> Result<Raster, QueryError> {
        let map_depth = self.grid().depth();
        let z = u8::try_from(z).ok().filter(|depth| *depth <= map_depth).ok_or_else(|| {
            let detail = format!("z must be between 0 and {map_depth}, the map's depth, got {z}");
            ServiceError::new(ErrorKind::TileOutOfRange, detail).at("z")
        })?;
        let side = 1_u32 << z;
        for (axis, value) in [("x", x), ("y", y)] {
            if value >= side {
                let detail = format!("{axis} must be below {side} (2^z) at z = {z}, got {value}");
                return Err(ServiceError::new(ErrorKind::TileOutOfRange, detail).at(axis).into());
            }
        }
        let depth = z + TILE_LEVELS;
        // Cells deeper than the leaves repeat them: `repeat` cells along each axis show one leaf.
        let read_depth = depth.min(map_depth);
        let repeat_levels = depth - read_depth;
        let read_side = TILE_SIDE >> repeat_levels;
        let (left, bottom) = (x * read_side, y * read_side);
        let range = LeafRange { min_x: left, min_y: bottom, max_x: left + read_side, max_y: bottom + read_side };
        let read = self.tree.try_raster(&range, read_depth)?;
        let classes = if repeat_levels == 0 { read } else { repeat(&read, repeat_levels) };
        Ok(self.raster(depth, x * TILE_SIDE, y * TILE_SIDE, (TILE_SIDE, TILE_SIDE), classes))
    }

    fn raster(&self, depth: u8, x: u32, y: u32, (width, height): (u32, u32), classes: Vec<Class>) -> Raster {
        let grid = self.grid();
        let cell_size = grid.resolution() * 2.0_f64.powi(i32::from(grid.depth()) - i32::from(depth));
        let (origin_x, origin_y) = grid.origin();
        Raster {
            map_id: self.id.0,
            revision: self.published.revision,
            depth,
            x,
            y,
            width,
            height,
            min: (origin_x + f64::from(x) * cell_size, origin_y + f64::from(y) * cell_size),
            cell_size,
            class_count: self.config.scale().count(),
            classes,
        }
    }

    /// Checks a tolerance: at most `u - 2`, above it no class is low enough.
    pub(super) fn tolerance(&self, tolerance: u32) -> Result<u8, ServiceError> {
        let largest = self.config.scale().unknown() - 2;
        u8::try_from(tolerance).ok().filter(|tolerance| *tolerance <= largest).ok_or_else(|| {
            let detail = format!(
                "tolerance {tolerance} can never be met in a map of {} classes: the largest is {largest}",
                self.config.scale().count()
            );
            ServiceError::new(ErrorKind::ToleranceTooHigh, detail).at("tolerance")
        })
    }

    /// Answers for regions, in order.
    pub(super) fn guaranteed_free(&self, regions: &[Region], tolerance: u8) -> Result<FreeAnswers, QueryError> {
        let free = |region| try_guaranteed_free(&self.tree, self.grid(), region, tolerance);
        Ok(FreeAnswers {
            revision: self.published.revision,
            sound: self.config.rule() == EvidenceRule::Guaranteed,
            depth: self.grid().depth(),
            results: regions.iter().map(free).collect::<Result<_, PageError>>()?,
        })
    }
}

/// A depth that was asked for; the map's by default.
pub(super) fn checked_depth(grid: &Grid, asked: Option<u32>) -> Result<u8, ServiceError> {
    let depth = grid.depth();
    match asked.map(u8::try_from) {
        None => Ok(depth),
        Some(Ok(asked)) if asked <= depth => Ok(asked),
        Some(_) => {
            let detail = format!("depth must be between 0 and {depth}, got {}", asked.unwrap_or_default());
            Err(ServiceError::new(ErrorKind::DepthOutOfRange, detail).at("depth"))
        }
    }
}

/// One axis of a box: what is left out is the root's. `None` when the box lies beyond the root by what is left out.
fn axis(name: &str, min: Option<f64>, max: Option<f64>, root: (f64, f64)) -> Result<Option<(f64, f64)>, ServiceError> {
    for (side, value) in [("min", min), ("max", max)] {
        if let Some(value) = value
            && !value.is_finite()
        {
            let field = format!("{side}_{name}");
            let detail = format!("{field} is not a finite number: {value}");
            return Err(ServiceError::new(ErrorKind::InvalidRegion, detail).at(field));
        }
    }
    if let (Some(min), Some(max)) = (min, max)
        && min > max
    {
        let field = format!("min_{name}");
        let detail = format!("the box is inverted: {field} {min} is above max_{name} {max}");
        return Err(ServiceError::new(ErrorKind::InvalidRegion, detail).at(field));
    }
    let (min, max) = (min.unwrap_or(root.0), max.unwrap_or(root.1));
    Ok((min <= max).then_some((min, max)))
}

fn too_large(setting: &'static str, what: &str, fits: Option<u8>) -> ServiceError {
    let hint = fits.map_or_else(|| "no depth fits".to_owned(), |depth| format!("depth {depth} fits"));
    ServiceError::over(ErrorKind::RegionTooLarge, setting, format!("{what}; {hint}")).at("depth")
}

/// Repeats every class `2^levels` times along both axes of a square raster.
fn repeat(read: &[Class], levels: u8) -> Vec<Class> {
    let read_side = (TILE_SIDE >> levels) as usize;
    let mut classes = Vec::with_capacity((TILE_SIDE * TILE_SIDE) as usize);
    for row in read.chunks_exact(read_side) {
        let wide: Vec<Class> = row.iter().flat_map(|class| std::iter::repeat_n(*class, 1 << levels)).collect();
        for _ in 0..1 << levels {
            classes.extend_from_slice(&wide);
        }
    }
    classes
}
