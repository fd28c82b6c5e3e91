//! A picture in colour: rectangles, lines, outlines and text, and other drawings side by side.

use super::font;
use std::io::Write;

/// Red, green, blue.
pub type Colour = [u8; 3];

/// Black.
pub const INK: Colour = [0, 0, 0];
/// White.
pub const PAPER: Colour = [255, 255, 255];

/// Rows of a line of text at size 1, pixels.
pub const LINE: u32 = font::HEIGHT + 3;

/// An RGB picture, row-major from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Drawing {
    width: u32,
    height: u32,
    pixels: Vec<Colour>,
}

impl Drawing {
    /// A drawing of one colour.
    #[must_use]
    pub fn new(width: u32, height: u32, colour: Colour) -> Self {
        Self { width, height, pixels: vec![colour; width as usize * height as usize] }
    }

    /// Width, pixels.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, pixels.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// The colour of a pixel; `None` outside.
    #[must_use]
    pub fn pixel(&self, x: u32, y: u32) -> Option<Colour> {
        (x < self.width && y < self.height).then(|| self.pixels[(y * self.width + x) as usize])
    }

    /// Sets a pixel; what lies outside is left out.
    pub fn set(&mut self, x: i64, y: i64, colour: Colour) {
        if (0..i64::from(self.width)).contains(&x) && (0..i64::from(self.height)).contains(&y) {
            self.pixels[y as usize * self.width as usize + x as usize] = colour;
        }
    }

    /// Fills a rectangle; what lies outside is left out.
    pub fn fill(&mut self, (x, y): (i64, i64), (width, height): (u32, u32), colour: Colour) {
        for row in y.max(0)..(y + i64::from(height)).min(i64::from(self.height)) {
            for column in x.max(0)..(x + i64::from(width)).min(i64::from(self.width)) {
                self.set(column, row, colour);
            }
        }
    }

    /// The outline of a rectangle, one pixel wide, inside of it.
    pub fn outline(&mut self, (x, y): (i64, i64), (width, height): (u32, u32), colour: Colour) {
        let (right, bottom) = (x + i64::from(width) - 1, y + i64::from(height) - 1);
        self.fill((x, y), (width, 1), colour);
        self.fill((x, bottom), (width, 1), colour);
        self.fill((x, y), (1, height), colour);
        self.fill((right, y), (1, height), colour);
    }

    /// A line, `thick` pixels wide; nothing where an end is not finite or far outside.
    pub fn line(&mut self, from: (f64, f64), to: (f64, f64), thick: u32, colour: Colour) {
        /// Beyond so many pixels there is no picture.
        const FAR: f64 = 1e5;
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        let steps = dx.abs().max(dy.abs()).ceil();
        if [from.0, from.1, to.0, to.1].iter().any(|v| !v.is_finite() || v.abs() > FAR) {
            return;
        }
        let half = 0.5 * f64::from(thick - thick.min(1));
        for step in 0..=steps as u32 {
            let t = if steps > 0.0 { f64::from(step) / steps } else { 0.0 };
            let at = ((from.0 + t * dx - half).round() as i64, (from.1 + t * dy - half).round() as i64);
            self.fill(at, (thick, thick), colour);
        }
    }

    /// A closed line through points.
    pub fn polygon(&mut self, points: &[(f64, f64)], thick: u32, colour: Colour) {
        for (i, from) in points.iter().enumerate() {
            self.line(*from, points[(i + 1) % points.len()], thick, colour);
        }
    }

    /// A line of text, its top left at a pixel; letters are `size` times 5 x 7.
    pub fn text(&mut self, (x, y): (i64, i64), text: &str, size: u32, colour: Colour) {
        font::each_dot(text, |column, row| {
            let at = (x + i64::from(column * size), y + i64::from(row * size));
            self.fill(at, (size, size), colour);
        });
    }

    /// Width of a line of text, pixels.
    #[must_use]
    pub fn text_width(text: &str, size: u32) -> u32 {
        font::width(text) * size
    }

    /// Puts another drawing into this one.
    pub fn place(&mut self, other: &Self, (x, y): (i64, i64)) {
        for row in 0..other.height {
            for column in 0..other.width {
                let colour = other.pixels[(row * other.width + column) as usize];
                self.set(x + i64::from(column), y + i64::from(row), colour);
            }
        }
    }

    /// Drawings side by side, `columns` a row, with a margin about each.
    #[must_use]
    pub fn beside(parts: &[Self], columns: usize) -> Self {
        const MARGIN: u32 = 8;
        let columns = columns.max(1);
        let rows: Vec<&[Self]> = parts.chunks(columns).collect();
        let width_of = |row: &[Self]| row.iter().map(|part| part.width + MARGIN).sum::<u32>() + MARGIN;
        let height_of = |row: &[Self]| row.iter().map(|part| part.height).max().unwrap_or(0) + MARGIN;
        let width = rows.iter().map(|row| width_of(row)).max().unwrap_or(1);
        let height = rows.iter().map(|row| height_of(row)).sum::<u32>() + MARGIN;
        let mut whole = Self::new(width, height, PAPER);
        let mut top = MARGIN;
        for row in rows {
            let mut left = MARGIN;
            for part in row {
                whole.place(part, (i64::from(left), i64::from(top)));
                left += part.width + MARGIN;
            }
            top += height_of(row);
        }
        whole
    }

    /// The drawing as a PNG file's bytes: greys alone where it has no colour.
    ///
    /// # Errors
    /// Those of the encoder.
    pub fn png(&self) -> std::io::Result<Vec<u8>> {
        let grey = self.pixels.iter().all(|[r, g, b]| r == g && g == b);
        let bytes: Vec<u8> =
            if grey { self.pixels.iter().map(|[r, ..]| *r).collect() } else { self.pixels.as_flattened().to_vec() };
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, self.width, self.height);
        encoder.set_color(if grey { png::ColorType::Grayscale } else { png::ColorType::Rgb });
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::High);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&bytes)?;
        writer.finish()?;
        file.flush()?;
        Ok(file)
    }
}
