//! The keys of the interface: `{prefix}/{map}/...`.

use crate::service::{ErrorKind, ServiceError};
use crate::store::MapName;
use crate::wire;

/// What a query's key asks for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Target {
    /// `{prefix}` or `{prefix}/*`: all maps.
    Maps,
    /// `{prefix}/{map}`
    Map(MapName),
    /// `{prefix}/{map}/{operation}`
    Operation(MapName, Operation),
}

/// What is asked of one map.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Operation {
    Create,
    Delete,
    /// With the robot's name.
    Insert(String),
    Classes,
    Region,
    Grid,
    /// Depth, column and row as the key has them.
    Tile([String; 3]),
    GuaranteedFree,
    Changes,
    Robots,
}

/// The map and robot of a key of best-effort scans, `{prefix}/{map}/scans/{robot}`.
pub fn scans<'a>(prefix: &str, key: &'a str) -> Option<(&'a str, &'a str)> {
    let rest = key.strip_prefix(prefix)?.strip_prefix('/')?;
    let (map, rest) = rest.split_once('/')?;
    let robot = rest.strip_prefix("scans/")?;
    (!robot.contains('/')).then_some((map, robot))
}

/// The target of a query's key; `None` for a key that is not of this prefix: somebody asks for everything there is.
///
/// # Errors
/// [`ErrorKind::RouteNotFound`], [`ErrorKind::InvalidName`].
pub fn target(prefix: &str, key: &str) -> Option<Result<Target, ServiceError>> {
    let rest = key.strip_prefix(prefix)?;
    if rest.is_empty() || rest == "/*" {
        return Some(Ok(Target::Maps));
    }
    Some(one_map(rest.strip_prefix('/')?, key))
}

fn one_map(rest: &str, key: &str) -> Result<Target, ServiceError> {
    let chunks: Vec<&str> = rest.split('/').collect();
    let (map, rest) = chunks.split_first().map_or(("", &[][..]), |(map, rest)| (*map, rest));
    let operation = match rest {
        [] => return Ok(Target::Map(wire::map_name(map)?)),
        ["create"] => Operation::Create,
        ["delete"] => Operation::Delete,
        ["insert", robot] => Operation::Insert((*robot).to_owned()),
        ["classes"] => Operation::Classes,
        ["region"] => Operation::Region,
        ["grid"] => Operation::Grid,
        ["tiles", z, x, y] => Operation::Tile([*z, *x, *y].map(str::to_owned)),
        ["guaranteed-free"] => Operation::GuaranteedFree,
        ["changes"] => Operation::Changes,
        ["robots"] => Operation::Robots,
        _ => {
            let key: String = key.chars().take(200).collect();
            return Err(ServiceError::new(ErrorKind::RouteNotFound, format!("there is nothing at key {key}")));
        }
    };
    Ok(Target::Operation(wire::map_name(map)?, operation))
}
