//! Answers of the service as messages.

use super::changes::changed_block;
use super::config::to_wire_config;
use super::v1;
use crate::mapping::MapConfig;
use crate::service::{ClassesAnswer, Created, MapDescription, Raster, RegionAnswer, RobotDescription};

/// The response to a creation.
#[must_use]
pub fn create_map_response(created: Created) -> v1::CreateMapResponse {
    let map = get_map_response(created.map);
    v1::CreateMapResponse {
        name: map.name,
        revision: map.revision,
        config: map.config,
        created: map.created,
        robots: map.robots,
        bounds: map.bounds,
        unknown_class: map.unknown_class,
        last_change: map.last_change,
        existed: !created.created,
    }
}

/// One map.
#[must_use]
pub fn get_map_response(map: MapDescription) -> v1::GetMapResponse {
    v1::GetMapResponse {
        name: map.name.to_string(),
        revision: map.revision,
        config: Some(to_wire_config(&map.config)),
        created: map.created,
        robots: map.robots.into_iter().map(robot).collect(),
        bounds: Some(bounds(&map.config)),
        unknown_class: map.config.scale().unknown().into(),
        last_change: map.last_change,
    }
}

/// All maps.
#[must_use]
pub fn list_maps_response(maps: Vec<MapDescription>) -> v1::ListMapsResponse {
    let maps = maps.into_iter().map(|map| v1::MapSummary {
        name: map.name.to_string(),
        revision: map.revision,
        config: Some(to_wire_config(&map.config)),
        created: map.created,
        bounds: Some(bounds(&map.config)),
        unknown_class: map.config.scale().unknown().into(),
    });
    v1::ListMapsResponse { maps: maps.collect() }
}

/// Classes at points.
#[must_use]
pub fn classes_response(answer: ClassesAnswer) -> v1::GetClassesResponse {
    v1::GetClassesResponse {
        revision: answer.revision,
        depth: answer.depth.into(),
        classes: answer.classes.into_iter().map(u32::from).collect(),
    }
}

/// Quadtree leaves.
#[must_use]
pub fn region_response(answer: RegionAnswer) -> v1::GetRegionResponse {
    let leaves = answer.leaves.into_iter().map(|leaf| v1::Leaf {
        depth: leaf.node.depth.into(),
        x: leaf.node.x,
        y: leaf.node.y,
        class: leaf.class.into(),
    });
    v1::GetRegionResponse {
        revision: answer.revision,
        depth: answer.depth.into(),
        leaves: leaves.collect(),
        last_change: answer.last_change,
        blocks: answer.blocks.into_iter().map(changed_block).collect(),
    }
}

/// A dense raster.
#[must_use]
pub fn grid_response(raster: Raster) -> v1::GetGridResponse {
    v1::GetGridResponse {
        revision: raster.revision,
        depth: raster.depth.into(),
        x: raster.x,
        y: raster.y,
        width: raster.width,
        height: raster.height,
        min_x: raster.min.0,
        min_y: raster.min.1,
        cell_size: raster.cell_size,
        class_count: raster.class_count.into(),
        classes: raster.classes,
    }
}

/// The tile `(z, x, y)`.
#[must_use]
pub fn tile_response(raster: Raster, (z, x, y): (u32, u32, u32)) -> v1::GetTileResponse {
    v1::GetTileResponse {
        revision: raster.revision,
        z,
        x,
        y,
        width: raster.width,
        height: raster.height,
        min_x: raster.min.0,
        min_y: raster.min.1,
        cell_size: raster.cell_size,
        class_count: raster.class_count.into(),
        classes: raster.classes,
    }
}

fn robot(robot: RobotDescription) -> v1::RobotState {
    v1::RobotState { robot: robot.name, highest_sequence: robot.highest_sequence, applied: robot.applied }
}

/// The root's square as the two given floats say it: for people and viewers, not rounded outward.
fn bounds(config: &MapConfig) -> v1::Bounds {
    let grid = config.grid();
    let (min_x, min_y) = grid.origin();
    let side = f64::from(grid.side()) * grid.resolution();
    v1::Bounds { min_x, min_y, max_x: min_x + side, max_y: min_y + side }
}
