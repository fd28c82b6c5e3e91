//! What of a map's configuration may change while it is there: its sensors, which are added or replaced.

use crate::mapping::MapConfig;

/// The first field in which a configuration differs beyond added and replaced sensors.
pub(super) fn first_difference(now: &MapConfig, asked: &MapConfig) -> Option<String> {
    let (a, b) = (now.grid(), asked.grid());
    let fields = [
        ("resolution", a.resolution() == b.resolution()),
        ("depth", a.depth() == b.depth()),
        ("origin", a.origin() == b.origin()),
        ("classes", now.scale() == asked.scale()),
        ("evidence", now.rule() == asked.rule()),
        ("min_obstacle_width", now.min_obstacle_width() == asked.min_obstacle_width()),
    ];
    let differing = fields.iter().find(|(_, same)| !same).map(|(field, _)| (*field).to_owned());
    // A sensor that is left out would be one that is taken away.
    let missing = || now.sensors().keys().find(|name| !asked.sensors().contains_key(*name));
    differing.or_else(|| missing().map(|name| format!("sensors.{name}")))
}
