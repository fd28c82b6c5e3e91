//! The guaranteed-free query.

use super::v1;
use crate::mapping::{FreeAnswer, Reason, Region, RegionError, RegionLimits, Witness};
use crate::service::{ErrorKind, FreeAnswers, ServiceError, setting};

/// The checked regions of a request.
///
/// # Errors
/// [`ErrorKind::InvalidRegion`] at the field at fault, such as `regions[0].disc.radius`.
pub fn regions(wire: Vec<v1::Region>, limits: &RegionLimits) -> Result<Vec<Region>, ServiceError> {
    wire.into_iter().enumerate().map(|(index, region)| one(region, index, limits)).collect()
}

/// The response to a query.
#[must_use]
pub fn free_response(answers: &FreeAnswers) -> v1::CheckGuaranteedFreeResponse {
    v1::CheckGuaranteedFreeResponse {
        revision: answers.revision,
        sound: answers.sound,
        results: answers.results.iter().map(result).collect(),
    }
}

fn one(region: v1::Region, index: usize, limits: &RegionLimits) -> Result<Region, ServiceError> {
    use v1::region::Shape;
    let need = |value: Option<f64>, field: &str| value.ok_or_else(|| missing(index, field));
    let built = match region.shape {
        None => {
            let detail = format!("regions[{index}] has no shape: give one of box, disc, polygon or path");
            return Err(ServiceError::new(ErrorKind::InvalidRegion, detail).at(format!("regions[{index}]")));
        }
        Some(Shape::Box(shape)) => {
            let min = (need(shape.min_x, "box.min_x")?, need(shape.min_y, "box.min_y")?);
            let max = (need(shape.max_x, "box.max_x")?, need(shape.max_y, "box.max_y")?);
            Region::rectangle(min, max)
        }
        Some(Shape::Disc(shape)) => {
            let center = shape.center.ok_or_else(|| missing(index, "disc.center"))?;
            let center = point(center, index, || "disc.center".to_owned())?;
            Region::disc(center, need(shape.radius, "disc.radius")?)
        }
        Some(Shape::Polygon(shape)) => Region::polygon(points(&shape.points, index, "polygon")?, limits),
        Some(Shape::Path(shape)) => {
            let line = points(&shape.points, index, "path")?;
            Region::path(line, need(shape.radius, "path.radius")?, limits)
        }
    };
    built.map_err(|error| region_error(&error, index))
}

fn points(wire: &[v1::Point], index: usize, shape: &str) -> Result<Vec<(f64, f64)>, ServiceError> {
    wire.iter().enumerate().map(|(at, wire)| point(*wire, index, || format!("{shape}.points[{at}]"))).collect()
}

fn point(wire: v1::Point, index: usize, field: impl Fn() -> String) -> Result<(f64, f64), ServiceError> {
    let need = |value: Option<f64>, axis: &str| value.ok_or_else(|| missing(index, &format!("{}.{axis}", field())));
    Ok((need(wire.x, "x")?, need(wire.y, "y")?))
}

fn missing(index: usize, field: &str) -> ServiceError {
    let field = format!("regions[{index}].{field}");
    ServiceError::new(ErrorKind::InvalidRegion, format!("{field} is missing")).at(field)
}

fn region_error(error: &RegionError, index: usize) -> ServiceError {
    let field = match error {
        RegionError::NotFinite { field, .. }
        | RegionError::Inverted { field, .. }
        | RegionError::Negative { field, .. }
        | RegionError::Points { field, .. } => field,
    };
    let detail = format!("regions[{index}].{error}");
    let refused = match error {
        RegionError::Points { max, count, .. } if count > max => {
            ServiceError::over(ErrorKind::InvalidRegion, setting::POINTS_PER_REGION, detail)
        }
        _ => ServiceError::new(ErrorKind::InvalidRegion, detail),
    };
    refused.at(format!("regions[{index}].{field}"))
}

fn result(answer: &FreeAnswer) -> v1::FreeResult {
    let reason = answer.refusal.map(|(reason, _)| match reason {
        Reason::Occupied => v1::Reason::Occupied,
        Reason::Unknown => v1::Reason::Unknown,
        Reason::Tolerance => v1::Reason::Tolerance,
    });
    v1::FreeResult {
        free: answer.free,
        max_class: answer.max_class.into(),
        reason: reason.map(i32::from),
        witness: answer.refusal.as_ref().map(|(_, found)| witness(found)),
    }
}

fn witness(found: &Witness) -> v1::Witness {
    v1::Witness {
        depth: found.node.map(|node| node.depth.into()),
        x: found.node.map(|node| node.x),
        y: found.node.map(|node| node.y),
        class: found.class.into(),
        min_x: found.min.0,
        min_y: found.min.1,
        size: found.size,
        distance: found.distance,
    }
}
