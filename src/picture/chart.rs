//! Line charts.

use super::drawing::{Colour, Drawing, INK, LINE, PAPER};

/// Colours of lines that a reader tells apart, also without red or green.
pub const LINES: [Colour; 6] = [[0, 90, 181], [220, 50, 32], [0, 130, 90], [150, 80, 160], [200, 140, 0], [90, 90, 90]];

const GRID: Colour = [225, 225, 225];
const MARGIN: (u32, u32) = (58, 30);
const TICKS: usize = 4;

/// How an axis runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// Evenly.
    Linear,
    /// By powers; values must be positive.
    Logarithmic,
}

/// One line of a chart: its name, and its points in ascending `x`.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// What the legend says.
    pub name: String,
    /// `(x, y)`
    pub points: Vec<(f64, f64)>,
}

/// A chart of several lines over one `x`.
#[derive(Debug, Clone, PartialEq)]
pub struct Chart {
    /// Above it.
    pub title: String,
    /// The axes.
    pub axes: (Axis, Axis),
    /// The lines; colours follow their order.
    pub series: Vec<Series>,
}

/// A range of values on so many pixels.
struct Scale {
    axis: Axis,
    lo: f64,
    hi: f64,
    pixels: f64,
}

impl Scale {
    fn new(axis: Axis, values: impl Iterator<Item = f64> + Clone, pixels: u32) -> Self {
        let (mut lo, mut hi) = (values.clone().fold(f64::INFINITY, f64::min), values.fold(f64::NEG_INFINITY, f64::max));
        if axis == Axis::Linear {
            lo = lo.min(0.0);
        }
        if !(lo.is_finite() && hi > lo) {
            (lo, hi) = (0.0, 1.0_f64.max(if hi.is_finite() { hi } else { 1.0 }));
        }
        let (lo, hi) = match axis {
            Axis::Linear => (lo, hi + 0.05 * (hi - lo)),
            Axis::Logarithmic => (lo.max(f64::MIN_POSITIVE).ln(), hi.ln()),
        };
        Self { axis, lo, hi, pixels: f64::from(pixels) }
    }

    fn at(&self, value: f64) -> f64 {
        let value = if self.axis == Axis::Logarithmic { value.max(f64::MIN_POSITIVE).ln() } else { value };
        (value - self.lo) / (self.hi - self.lo) * self.pixels
    }

    /// Values worth a line of the grid.
    fn ticks(&self) -> Vec<f64> {
        match self.axis {
            Axis::Linear => {
                let step = round_up((self.hi - self.lo) / TICKS as f64);
                (0..=2 * TICKS)
                    .map(|i| (self.lo / step).ceil() * step + step * i as f64)
                    .filter(|v| *v <= self.hi)
                    .collect()
            }
            Axis::Logarithmic => {
                let decades = (self.hi - self.lo) / std::f64::consts::LN_10;
                let steps: &[f64] = if decades > 3.0 { &[1.0] } else { &[1.0, 2.0, 5.0] };
                let powers = (self.lo / std::f64::consts::LN_10).floor() as i32
                    ..=(self.hi / std::f64::consts::LN_10).ceil() as i32;
                let values = powers.flat_map(|power| steps.iter().map(move |step| step * 10_f64.powi(power)));
                values.filter(|v| (self.lo - 1e-9..=self.hi + 1e-9).contains(&v.ln())).collect()
            }
        }
    }
}

/// 1, 2 or 5 times a power of ten, not below a value.
fn round_up(value: f64) -> f64 {
    let power = 10_f64.powf(value.max(1e-300).log10().floor());
    [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .map(|step| step * power)
        .find(|step| *step >= value * (1.0 - 1e-9))
        .unwrap_or(value)
}

/// A number in few characters.
#[must_use]
pub fn short(value: f64) -> String {
    let size = value.abs();
    let text = match size {
        _ if size >= 100.0 || size == 0.0 => format!("{value:.0}"),
        _ if size >= 1.0 => format!("{value:.2}"),
        _ => format!("{value:.4}"),
    };
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

impl Chart {
    /// Draws the chart with its legend below.
    #[must_use]
    pub fn draw(&self, width: u32, height: u32) -> Drawing {
        let legend = self.legend_rows(width);
        let (left, top) = (MARGIN.0, LINE + 10);
        let plot =
            (width.saturating_sub(left + 12).max(1), height.saturating_sub(top + MARGIN.1 + legend * LINE).max(1));
        let points = || self.series.iter().flat_map(|series| series.points.iter());
        let across = Scale::new(self.axes.0, points().map(|p| p.0), plot.0);
        let up = Scale::new(self.axes.1, points().map(|p| p.1), plot.1);
        let mut drawing = Drawing::new(width, height, PAPER);
        drawing.text((i64::from(left), 4), &self.title, 1, INK);
        let at = |x: f64, y: f64| (f64::from(left) + across.at(x), f64::from(top + plot.1) - up.at(y));
        let (origin, bottom) = (f64::from(left), f64::from(top + plot.1));
        for value in across.ticks() {
            let x = f64::from(left) + across.at(value);
            drawing.line((x, f64::from(top)), (x, bottom), 1, GRID);
            let word = short(value);
            let half = Drawing::text_width(&word, 1) / 2;
            drawing.text((x as i64 - i64::from(half), bottom as i64 + 5), &word, 1, INK);
        }
        for value in up.ticks() {
            let y = bottom - up.at(value);
            drawing.line((origin, y), (origin + f64::from(plot.0), y), 1, GRID);
            let word = short(value);
            let wide = Drawing::text_width(&word, 1) + 5;
            drawing.text((origin as i64 - i64::from(wide), y as i64 - 4), &word, 1, INK);
        }
        drawing.outline((i64::from(left), i64::from(top)), plot, INK);
        for (series, colour) in self.series.iter().zip(LINES.iter().cycle()) {
            for pair in series.points.windows(2) {
                drawing.line(at(pair[0].0, pair[0].1), at(pair[1].0, pair[1].1), 2, *colour);
            }
            for (x, y) in series.points.iter().map(|(x, y)| at(*x, *y)).filter(|(x, y)| x.is_finite() && y.is_finite())
            {
                drawing.fill((x.round() as i64 - 2, y.round() as i64 - 2), (5, 5), *colour);
            }
        }
        self.draw_legend(&mut drawing, top + plot.1 + MARGIN.1 - 8);
        drawing
    }

    /// Where each name of the legend stands: row and left edge.
    fn legend_places(&self, width: u32) -> Vec<(u32, u32)> {
        let (mut row, mut x) = (0, MARGIN.0);
        let mut places = Vec::new();
        for series in &self.series {
            let wide = Drawing::text_width(&series.name, 1) + 34;
            if x + wide > width && x > MARGIN.0 {
                (row, x) = (row + 1, MARGIN.0);
            }
            places.push((row, x));
            x += wide;
        }
        places
    }

    fn legend_rows(&self, width: u32) -> u32 {
        self.legend_places(width).last().map_or(0, |(row, _)| row + 1)
    }

    fn draw_legend(&self, drawing: &mut Drawing, top: u32) {
        let places = self.legend_places(drawing.width());
        for ((series, (row, x)), colour) in self.series.iter().zip(places).zip(LINES.iter().cycle()) {
            let y = i64::from(top + row * LINE);
            drawing.fill((i64::from(x), y + 2), (16, 3), *colour);
            drawing.text((i64::from(x) + 20, y), &series.name, 1, INK);
        }
    }
}
