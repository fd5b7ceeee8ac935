//! The surfaces of every pixel: peaks that stand out, planes through the power around them, and what supports them.

use super::columns::RayColumns;
use super::leak::leaked;
use super::levels::Levels;
use super::patch::{TangentPlane, fit};
use super::peaks::{Peak, peaks};
use super::power::Power;
use super::rims::trim;
use super::support::supported;
use super::{ArraySidelobes, DepthOptions, Looks, Pick, gate, glints};
use crate::error::Result;
use crate::grid::{DepthLayer, Raster, VolumeView, pixel_values};

/// Share of a neighbour's power that its sidelobes may have, of the strongest peak of a column and of further ones, which
/// stand out by other rules too; of a lattice without a window.
const SIDELOBES: [f64; 2] = [0.12, 0.05];

/// The most that any array's sidelobes are taken to be: weaker surfaces beside bright ones are not lost for it.
const MOST_SIDELOBES: f64 = 0.25;

/// What the gate leaves of surfaces at least, diffuse ones, in the 99th percentile of the columns' maxima; of mirrors' glints and of the
/// sidelobes of what is outside the grid it leaves less.
const FLAT: f32 = 0.48;

/// A surface at a pixel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Surface {
    pub(super) patch: TangentPlane,
    /// Smoothed power at its depth.
    pub(super) power: f32,
    /// dB.
    pub(super) confidence: f64,
    /// Whether only its neighbours tell of it.
    filled: bool,
}

/// Bytes of a pixel's surfaces, usually one or two, before and after those without support are gone; how they continue, and
/// which are beyond a rim, take less.
pub(super) const BYTES_PER_PIXEL: u64 = 2 * (size_of::<Vec<Surface>>() + 2 * size_of::<Surface>()) as u64;

/// The picked return of every pixel with its confidence, and all returns.
pub(super) type Layers = (DepthLayer, Vec<f32>, Vec<DepthLayer>);

/// The layers, and what the picture looks like.
///
/// # Errors
/// When the powers or a map do not fit in memory.
pub(super) fn locate(
    volume: VolumeView<'_>,
    raster: &Raster,
    options: &DepthOptions,
    outside: &mut (dyn FnMut() -> Result<f64> + Send),
) -> Result<(Layers, Looks)> {
    let grid = volume.grid;
    let mut power = Power::of(volume)?;
    let reference = |power: &Power| -> Result<f32> {
        Ok(Levels::of(&RayColumns::new(power, raster).maxima()?, options)?.reference)
    };
    let shown = reference(&power)?;
    let mut beside = options.outside;
    // What phases tell; not in a mean of powers, which has none.
    let mut phases = None;
    if let (true, Some(aperture)) = (options.gate, &options.resolution.aperture) {
        phases = Some((aperture, gate::flatten(&mut power, volume, aperture, options)?));
        if beside == 0.0 && reference(&power)? < FLAT * shown {
            beside = outside()?;
        }
    }
    let smooth = power.copied()?.smoothed_for(options)?;
    let columns = RayColumns::new(&smooth, raster);
    let maxima = columns.maxima()?;
    let alone = Levels::of(&maxima, options)?.with_noise_of(&smooth.values);
    let levels = alone.beside(shown, beside, options.sidelobes);
    let outshone = levels.reference > alone.reference;
    let threshold = levels.detectable(options.threshold_db.unwrap_or(options.return_threshold_db));
    let patch =
        |pixel: usize, depth: f64| fit(&power, (raster.point(pixel, 0.0), raster.ray(pixel)), depth, options);
    let mut found: Vec<Vec<Surface>> = pixel_values(Vec::new(), raster.len())?;
    let relative = 10f64.powf((options.sidelobes.near_db - ArraySidelobes::default().near_db) / 10.0);
    let sidelobes = SIDELOBES.map(|share| (share * relative).min(MOST_SIDELOBES));
    columns.each(&mut found, |pixel, column, found| {
        let accepted = |peak: &Peak, first: bool| {
            let here = raster.point(pixel, grid.z.position(peak.index));
            let sure = peak.confidence >= options.confidence_db && peak.power >= threshold;
            (!first || sure) && !leaked(&smooth, here, peak.power, sidelobes[usize::from(!first)], options)
        };
        for Peak { depth, power, confidence, .. } in
            peaks(column, &grid.z, levels, options.surfaces(), options, accepted)
        {
            let patch = patch(pixel, depth);
            found.extend(patch.map(|patch| Surface { patch, power, confidence, filled: false }));
        }
    });
    let fill = |pixel: usize, depth: f64| {
        let patch = patch(pixel, depth)?;
        let index = grid.z.index_of(patch.depth)?;
        let (power, clutter) = columns.of(pixel, |column| (column[index], levels.clutter(column)));
        let confidence = levels.confidence(power, clutter);
        Some(Surface { patch, power, confidence, filled: true })
    };
    let mut surfaces =
        supported(&found, |pixel| grid.z.position(maxima[pixel].1), raster, (&grid, options), fill)?;
    drop(found);
    trim(&mut surfaces, raster, (&grid, options))?;
    let mirrors = match phases {
        Some(known) => glints::are_shown(&surfaces, known, volume, raster, options)?,
        None => false,
    };
    if mirrors {
        glints::keep(&mut surfaces, &smooth, raster, options);
    }
    // By the power around: whose speckle is stronger at the pixel itself is chance. A mirror has none.
    let strength = |surface: &Surface| if mirrors { f64::from(surface.power) } else { surface.patch.mass };
    Ok((layers(&surfaces, strength, raster, options)?, Looks { outshone, mirrors }))
}

/// The picked surface of every pixel with its confidence, and all of them front to back.
fn layers(
    surfaces: &[Vec<Surface>],
    strength: impl Fn(&Surface) -> f64,
    raster: &Raster,
    options: &DepthOptions,
) -> Result<Layers> {
    let layer = |surface: &dyn Fn(&[Surface]) -> Option<Surface>| -> Result<DepthLayer> {
        let mut layer = DepthLayer::empty(raster.len())?;
        let mut confidence = pixel_values(f32::NAN, raster.len())?;
        let mut error = pixel_values(f32::NAN, raster.len())?;
        let mut normal = pixel_values([f32::NAN; 3], raster.len())?;
        for (pixel, found) in surfaces.iter().enumerate() {
            let Some(found) = surface(found) else { continue };
            layer.depth[pixel] = found.patch.depth as f32;
            layer.strength[pixel] = found.power.sqrt();
            confidence[pixel] = found.confidence as f32;
            error[pixel] = found.patch.error as f32;
            normal[pixel] = found.patch.normal();
        }
        (layer.confidence, layer.error, layer.normal) = (Some(confidence), Some(error), Some(normal));
        Ok(layer)
    };
    let rank = |a: &&Surface, b: &&Surface| b.filled.cmp(&a.filled).then(strength(a).total_cmp(&strength(b)));
    let mut picked = layer(&|found| match options.pick {
        Pick::First => found.first().copied(),
        Pick::Strongest => found.iter().max_by(rank).copied(),
    })?;
    let returns = if options.returns >= 2 { options.returns } else { 0 };
    let returns = (0..returns).map(|k| layer(&|found| found.get(k).copied())).collect::<Result<_>>()?;
    let confidence = picked.confidence.take().unwrap_or_default();
    Ok((picked, confidence, returns))
}
