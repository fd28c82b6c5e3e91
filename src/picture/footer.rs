//! The band below the map: scale bar, legend, caption.

use super::{Picture, font, shade};
use crate::quadtree::ClassScale;

const INK: u8 = 0;
const PAPER: u8 = 255;

/// Parts of the scale bar, drawn black and white in turn.
const BAR_PARTS: u32 = 4;

pub(super) struct Footer {
    width: u32,
    /// Pixels of the picture a pixel of the font.
    text: u32,
    bar_pixels: u32,
    bar_label: String,
    caption: String,
}

impl Footer {
    /// Lays the band out for a picture `width` pixels wide with so many pixels a metre.
    pub(super) fn new(width: u32, pixels_per_metre: f64, caption: &str) -> Self {
        let text = (width / 500).clamp(1, 6);
        let metres = bar_length(f64::from(width) / 4.0 / pixels_per_metre);
        let bar_pixels = (metres * pixels_per_metre).round().max(1.0) as u32;
        Self { width, text, bar_pixels, bar_label: length_label(metres), caption: caption.to_owned() }
    }

    fn pad(&self) -> u32 {
        8 * self.text
    }

    fn line(&self) -> u32 {
        (font::HEIGHT + 5) * self.text
    }

    /// Height of the band, pixels.
    pub(super) fn height(&self) -> u32 {
        2 * self.pad() + self.line() + font::HEIGHT * self.text
    }

    /// Draws the band from row `top` down.
    pub(super) fn draw(&self, picture: &mut Picture, top: u32, scale: ClassScale) {
        picture.fill(0, top, self.width, self.height(), PAPER);
        picture.fill(0, top, self.width, self.text, INK);
        let first = top + self.pad();
        self.draw_bar(picture, self.pad(), first);
        self.draw_legend(picture, first, scale);
        self.write(picture, self.pad(), first + self.line(), &self.caption);
    }

    fn draw_bar(&self, picture: &mut Picture, left: u32, top: u32) {
        let height = 6 * self.text;
        let middle = top + self.text;
        picture.fill(left, middle, self.bar_pixels, height, INK);
        for part in (1..BAR_PARTS).step_by(2) {
            let from = left + self.bar_pixels * part / BAR_PARTS;
            let to = left + self.bar_pixels * (part + 1) / BAR_PARTS;
            let inner = (to - from).saturating_sub(if part + 1 == BAR_PARTS { self.text } else { 0 });
            picture.fill(from, middle + self.text, inner, height - 2 * self.text, PAPER);
        }
        self.write(picture, left + self.bar_pixels + 6 * self.text, top, &self.bar_label);
    }

    fn draw_legend(&self, picture: &mut Picture, top: u32, scale: ClassScale) {
        let entries = [("free", scale.free()), ("unknown", scale.unknown()), ("occupied", scale.occupied())];
        let swatch = 9 * self.text;
        let mut x = self.width - self.pad();
        for (word, class) in entries.into_iter().rev() {
            x = x.saturating_sub(font::width(word) * self.text);
            self.write(picture, x, top, word);
            x = x.saturating_sub(swatch + 4 * self.text);
            picture.fill(x, top, swatch, swatch, INK);
            picture.fill(
                x + self.text,
                top + self.text,
                swatch - 2 * self.text,
                swatch - 2 * self.text,
                shade(class, scale),
            );
            x = x.saturating_sub(12 * self.text);
        }
    }

    fn write(&self, picture: &mut Picture, left: u32, top: u32, text: &str) {
        font::each_dot(text, |x, y| {
            picture.fill(left + x * self.text, top + y * self.text, self.text, self.text, INK);
        });
    }
}

/// The largest of 1, 2, 5, 10, .. (and their tenths) metres that is no longer than `limit`.
fn bar_length(limit: f64) -> f64 {
    let power = 10_f64.powf(limit.max(1e-6).log10().floor());
    [5.0, 2.0, 1.0].into_iter().map(|step| step * power).find(|length| *length <= limit).unwrap_or(power)
}

fn length_label(metres: f64) -> String {
    if metres >= 1000.0 {
        format!("{} km", metres / 1000.0)
    } else if metres >= 1.0 {
        format!("{} m", metres.round())
    } else if metres >= 0.01 {
        format!("{} cm", (metres * 100.0).round())
    } else {
        format!("{} mm", metres * 1000.0)
    }
}
