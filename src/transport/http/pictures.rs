//! Rasters as NumPy arrays and PNG images.

use super::HttpError;
use crate::quadtree::{Class, ClassScale};
use crate::service::{ErrorKind, Raster};
use npyz::WriterBuilder;

/// Grey of unknown cells; free ones are white, occupied ones black.
const UNKNOWN_GREY: f64 = 160.0;

/// A `.npy` file of shape `(height, width)`, `u8`, C order, row 0 at min_y.
///
/// # Errors
/// [`ErrorKind::Internal`] when it cannot be written.
pub fn npy(raster: &Raster) -> Result<Vec<u8>, HttpError> {
    let write = || -> std::io::Result<Vec<u8>> {
        let mut bytes = Vec::with_capacity(raster.classes.len() + 128);
        let shape = [u64::from(raster.height), u64::from(raster.width)];
        let mut writer = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(&mut bytes).begin_nd()?;
        writer.extend(raster.classes.iter().copied())?;
        writer.finish()?;
        Ok(bytes)
    };
    write().map_err(|error| failed(&error))
}

/// An 8-bit grey PNG image, its top row at max_y: free white, unknown grey, occupied black, shades between.
///
/// # Errors
/// [`ErrorKind::Internal`] when it cannot be written, as for a raster without cells.
pub fn png(raster: &Raster) -> Result<Vec<u8>, HttpError> {
    let shades = shades(raster.class_count);
    let width = usize::try_from(raster.width).unwrap_or(usize::MAX).max(1);
    let pixels: Vec<u8> =
        raster.classes.chunks(width).rev().flatten().map(|class| shades[usize::from(*class)]).collect();
    let write = || -> Result<Vec<u8>, png::EncodingError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, raster.width, raster.height);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Fast);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&pixels)?;
        writer.finish()?;
        Ok(bytes)
    };
    write().map_err(|error| failed(&error))
}

/// The grey of each class: white at 1, [`UNKNOWN_GREY`] at unknown, black at `k`, evenly between.
fn shades(class_count: u8) -> [u8; 256] {
    let mut shades = [0; 256];
    // A map always has a valid scale.
    let Ok(scale) = ClassScale::new(class_count.into()) else { return shades };
    let (free, unknown, occupied) = (scale.free(), scale.unknown(), scale.occupied());
    let part = |class: Class, from: Class, to: Class| f64::from(class - from) / f64::from(to - from);
    for class in free..=occupied {
        let grey = if class <= unknown {
            255.0 + (UNKNOWN_GREY - 255.0) * part(class, free, unknown)
        } else {
            UNKNOWN_GREY * (1.0 - part(class, unknown, occupied))
        };
        shades[usize::from(class)] = grey.round() as u8;
    }
    shades
}

fn failed(error: &dyn std::error::Error) -> HttpError {
    tracing::error!(%error, "a raster cannot be written");
    HttpError::new(ErrorKind::Internal, "the server failed to write the raster")
}
