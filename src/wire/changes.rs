//! What changed: requests of changes and watches, and their answers.

use super::robots::robot_pose;
use super::v1;
use crate::service::{BlockChange, BoxQuery, Changes, ChangesQuery};

/// The query of a request for changes.
#[must_use]
pub fn changes_query(request: &v1::GetChangesRequest) -> ChangesQuery {
    let area = BoxQuery {
        min_x: request.min_x,
        min_y: request.min_y,
        max_x: request.max_x,
        max_y: request.max_y,
        depth: request.depth,
    };
    ChangesQuery { area, contents: request.contents, robots: false }
}

/// The query of a watch.
#[must_use]
pub fn watch_query(request: &v1::WatchMapRequest) -> ChangesQuery {
    let area = BoxQuery {
        min_x: request.min_x,
        min_y: request.min_y,
        max_x: request.max_x,
        max_y: request.max_y,
        depth: request.depth,
    };
    ChangesQuery { area, contents: request.contents, robots: request.robots }
}

/// The response to a request for changes.
#[must_use]
pub fn changes_response(changes: Changes) -> v1::GetChangesResponse {
    let v1::WatchMapResponse { revision, since, everything, blocks, depth, .. } = watch_response(changes);
    v1::GetChangesResponse { revision, since, everything, blocks, depth }
}

/// One message of a watch.
#[must_use]
pub fn watch_response(changes: Changes) -> v1::WatchMapResponse {
    v1::WatchMapResponse {
        revision: changes.revision,
        since: changes.since,
        everything: changes.everything,
        blocks: changes.blocks.into_iter().map(changed_block).collect(),
        depth: changes.depth.into(),
        robots: changes.robots.into_iter().map(robot_pose).collect(),
    }
}

/// One changed block.
pub(super) fn changed_block(block: BlockChange) -> v1::ChangedBlock {
    v1::ChangedBlock {
        depth: block.node.depth.into(),
        x: block.node.x,
        y: block.node.y,
        revision: block.revision,
        classes: block.classes,
        changed: block.changed,
    }
}
