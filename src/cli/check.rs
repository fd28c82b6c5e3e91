//! `ubbmap check`: a guaranteed-free query.

use super::client::{Client, ClientError, ServerOptions, map_name, snapshot_name};
use super::options::numbers;
use super::output::{Failure, say, say_json};
use crate::store::{MapName, SnapshotName};
use crate::wire::v1::{self, region::Shape};
use clap::Args;

/// Asks a server which regions of a map are guaranteed free.
#[derive(Debug, Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Numbers are metres, with commas or blanks between. Answers come for boxes, then discs, polygons and \
    paths.\n\nExample:\n  ubbmap check --map hall --disc 2,1,0.4 --path 0,0,5,0,5,2,0.35 --tolerance 1"
)]
pub(super) struct Check {
    /// The map
    #[arg(long, value_name = "NAME", value_parser = map_name)]
    map: MapName,
    /// A box: MIN_X,MIN_Y,MAX_X,MAX_Y
    #[arg(long = "box", value_name = "BOX", value_parser = parse_box, allow_hyphen_values = true)]
    boxes: Vec<v1::Region>,
    /// A disc: X,Y,RADIUS
    #[arg(long = "disc", value_name = "DISC", value_parser = parse_disc, allow_hyphen_values = true)]
    discs: Vec<v1::Region>,
    /// A polygon of at least three corners: X,Y,X,Y,X,Y
    #[arg(long = "polygon", value_name = "CORNERS", value_parser = parse_polygon, allow_hyphen_values = true)]
    polygons: Vec<v1::Region>,
    /// All within RADIUS of a line through points: X,Y,X,Y,..,RADIUS
    #[arg(long = "path", value_name = "PATH", value_parser = parse_path, allow_hyphen_values = true)]
    paths: Vec<v1::Region>,
    /// How many of the scans applied there may have broken an assumption
    #[arg(long, default_value_t = 0, value_name = "Q")]
    tolerance: u32,
    /// Ask this snapshot of the map, not the map as it is now
    #[arg(long, value_name = "NAME", value_parser = snapshot_name)]
    snapshot: Option<SnapshotName>,
    /// Exit with code 1 unless every region is guaranteed free
    #[arg(long)]
    require_free: bool,
    #[command(flatten)]
    server: ServerOptions,
    /// Print the answer as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
}

impl Check {
    /// Runs the command.
    pub(super) fn run(self) -> Result<(), Failure> {
        let named = |name: &str, count: usize| (1..=count).map(|i| format!("{name} {i}")).collect::<Vec<_>>();
        let names = [
            named("box", self.boxes.len()),
            named("disc", self.discs.len()),
            named("polygon", self.polygons.len()),
            named("path", self.paths.len()),
        ]
        .concat();
        let regions = [self.boxes, self.discs, self.polygons, self.paths].concat();
        if regions.is_empty() {
            return Err(Failure::Usage("name a region: --box, --disc, --polygon or --path".to_owned()));
        }
        let client = Client::new(&self.server)?;
        let answer = client.check(&self.map, self.snapshot.as_ref(), regions, self.tolerance);
        let answer = answer.map_err(|error| match (in_the_words_of_the_flags(&error, &names), &self.snapshot) {
            (Some(usage), _) => usage,
            (None, Some(snapshot)) => client.explain_snapshot(&self.map, snapshot, error),
            (None, None) => client.explain(&self.map, error),
        })?;
        if self.json {
            say_json(&answer)?;
        } else {
            for (name, result) in names.iter().zip(&answer.results) {
                say(&format!("{name}: {}", describe(result)))?;
            }
            if !answer.sound {
                say("the map's evidence rule proves nothing: these answers are not guarantees")?;
            }
        }
        let refused = answer.results.iter().filter(|result| !result.free).count();
        if self.require_free && refused > 0 {
            return Err(anyhow::anyhow!("{refused} of {} regions are not guaranteed free", answer.results.len()).into());
        }
        Ok(())
    }
}

/// A region that makes no sense is bad usage, told by the name that its answer would have had.
fn in_the_words_of_the_flags(error: &ClientError, names: &[String]) -> Option<Failure> {
    let ClientError::Refused { code, detail, .. } = error else { return None };
    if code != "INVALID_REGION" {
        return None;
    }
    let (index, rest) = detail.strip_prefix("regions[")?.split_once("].")?;
    let name = names.get(index.parse::<usize>().ok()?)?;
    Some(Failure::Usage(format!("{name}: {rest} ({code})")))
}

fn describe(result: &v1::FreeResult) -> String {
    if result.free {
        return "free".to_owned();
    }
    let reason = match result.reason() {
        v1::Reason::Occupied => "occupied",
        v1::Reason::Unknown => "unknown",
        v1::Reason::Tolerance => "free, but not by enough for the tolerance",
        v1::Reason::Unspecified => "no reason given",
    };
    let Some(witness) = &result.witness else { return format!("not free: {reason}") };
    let along = witness.distance.map(|distance| format!(", {distance:.3} m along the path")).unwrap_or_default();
    format!(
        "not free: {reason} at {:.3},{:.3} (a leaf of {} m, class {}){along}",
        witness.min_x, witness.min_y, witness.size, witness.class
    )
}

fn region(shape: Shape) -> v1::Region {
    v1::Region { shape: Some(shape) }
}

fn points(values: &[f64]) -> Vec<v1::Point> {
    values.chunks_exact(2).map(|pair| v1::Point { x: Some(pair[0]), y: Some(pair[1]) }).collect()
}

fn parse_box(text: &str) -> Result<v1::Region, String> {
    let [min_x, min_y, max_x, max_y] = numbers(text)?[..] else {
        return Err("a box is four numbers: MIN_X,MIN_Y,MAX_X,MAX_Y".to_owned());
    };
    let (min_x, min_y, max_x, max_y) = (Some(min_x), Some(min_y), Some(max_x), Some(max_y));
    Ok(region(Shape::Box(v1::BoxRegion { min_x, min_y, max_x, max_y })))
}

fn parse_disc(text: &str) -> Result<v1::Region, String> {
    let [x, y, radius] = numbers(text)?[..] else {
        return Err("a disc is three numbers: X,Y,RADIUS".to_owned());
    };
    let center = Some(v1::Point { x: Some(x), y: Some(y) });
    Ok(region(Shape::Disc(v1::DiscRegion { center, radius: Some(radius) })))
}

fn parse_polygon(text: &str) -> Result<v1::Region, String> {
    let values = numbers(text)?;
    if values.len() < 6 || values.len() % 2 != 0 {
        return Err("a polygon is X,Y for each of at least three corners".to_owned());
    }
    Ok(region(Shape::Polygon(v1::PolygonRegion { points: points(&values) })))
}

fn parse_path(text: &str) -> Result<v1::Region, String> {
    let values = numbers(text)?;
    match values.split_last() {
        Some((radius, line)) if line.len() >= 2 && line.len() % 2 == 0 => {
            Ok(region(Shape::Path(v1::PathRegion { points: points(line), radius: Some(*radius) })))
        }
        _ => Err("a path is X,Y for each point, then its radius".to_owned()),
    }
}
