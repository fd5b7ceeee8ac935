//! The depth maps of a page: the picked return, every return where there are several, the truth and the errors.

use super::miniature::code;
use super::payload::{pack, pack_floats};
use crate::error::Result;
use crate::grid::{Axis, DepthLayer, DepthMap};
use crate::metrics::error_map;
use serde_json::{Map, Value, json};

/// Maximum number of pixels of a map along one axis; a larger map is subsampled, never blended.
const MAP_PIXELS: usize = 512;

/// The direction towards the light that shades surfaces, and how bright they are without it.
const LIGHT: [f32; 3] = [-0.45, -0.55, -0.703_56];
const AMBIENT: f32 = 0.45;

/// Every n-th pixel along both axes.
struct Thinning {
    step: usize,
    columns: usize,
}

impl Thinning {
    fn of(map: &DepthMap) -> Self {
        let step = map.x.count.max(map.y.count).div_ceil(MAP_PIXELS).max(1);
        Self { step, columns: map.x.count }
    }

    fn axis(&self, axis: &Axis) -> Axis {
        let count = axis.count.div_ceil(self.step);
        Axis { first: axis.first, pitch: axis.pitch * self.step as f64, count }
    }

    fn values<T: Copy>(&self, values: &[T]) -> Vec<T> {
        let rows = values.chunks_exact(self.columns.max(1)).step_by(self.step);
        rows.flat_map(|row| row.iter().copied().step_by(self.step)).collect()
    }
}

/// The maps; every n-th pixel of those that are too large.
///
/// # Errors
/// A truth with other pixels.
pub(super) fn packed(depth: &DepthMap, truth: Option<&DepthMap>) -> Result<Value> {
    let thinning = Thinning::of(depth);
    let peak = depth.picked.strength.iter().copied().filter(|v| v.is_finite()).fold(0.0, f32::max);
    let surface = |layer: &DepthLayer, confidence: &[f32]| -> Result<Map<String, Value>> {
        let amplitude: Vec<u8> =
            thinning.values(&layer.strength).into_iter().map(|v| code(v, peak)).collect();
        let mut packed = Map::new();
        packed.insert("depth".into(), pack_floats(&thinning.values(&layer.depth)).into());
        packed.insert("amplitude".into(), pack(&amplitude).into());
        if !confidence.is_empty() {
            packed.insert("confidence".into(), pack_floats(&thinning.values(confidence)).into());
        }
        if let Some(normals) = &layer.normal {
            packed.insert("shading".into(), shading(&thinning.values(normals)).into());
        }
        if let Some(truth) = truth {
            let errors = error_map(&DepthMap::new(depth.raster(), layer.clone()), truth)?;
            packed.insert("error".into(), pack_floats(&thinning.values(&errors)).into());
        }
        Ok(packed)
    };
    let mut maps = json!({
        "x": thinning.axis(&depth.x),
        "y": thinning.axis(&depth.y),
        "view": depth.view,
        "reduced": thinning.step,
        "picked": surface(&depth.picked, &depth.confidence)?,
    });
    // Without a second return anywhere there is nothing to choose from.
    let several = depth.returns.iter().filter(|layer| layer.depth.iter().any(|z| z.is_finite())).count();
    if several > 1 {
        let returns = depth.returns[..several].iter().map(|layer| {
            let (layer, same) = besides(layer, &depth.picked);
            let mut packed = surface(&layer, layer.confidence.as_deref().unwrap_or_default())?;
            packed.insert("same".into(), pack(&thinning.values(&same)).into());
            Ok(packed)
        });
        maps["returns"] = returns.collect::<Result<Vec<_>>>()?.into();
    }
    if let Some(truth) = truth {
        maps["truth"] = pack_floats(&thinning.values(&truth.picked.depth)).into();
        if let Some(normals) = &truth.picked.normal {
            maps["true_shading"] = shading(&thinning.values(normals)).into();
        }
    }
    Ok(maps)
}

/// A return without the pixels whose depth is the picked one, and where these are: most are, so little remains to be stored.
fn besides(layer: &DepthLayer, picked: &DepthLayer) -> (DepthLayer, Vec<u8>) {
    let same: Vec<u8> = layer.depth.iter().zip(&picked.depth).map(|(z, other)| (z == other).into()).collect();
    let without = |values: &[f32]| -> Vec<f32> {
        values.iter().zip(&same).map(|(&v, &same)| if same == 1 { f32::NAN } else { v }).collect()
    };
    let rest = DepthLayer {
        depth: without(&layer.depth),
        strength: without(&layer.strength),
        confidence: layer.confidence.as_deref().map(without),
        normal: layer.normal.as_ref().map(|normals| {
            normals.iter().zip(&same).map(|(&n, &same)| if same == 1 { [f32::NAN; 3] } else { n }).collect()
        }),
        ..DepthLayer::default()
    };
    (rest, same)
}

/// How bright surfaces with these normals are drawn, 255 for 1.
fn shading(normals: &[[f32; 3]]) -> String {
    pack(&normals.iter().map(|normal| (255.0 * lit(normal)).round() as u8).collect::<Vec<u8>>())
}

/// How bright a surface is drawn: by its unit normal, which faces the array, in light from the upper left; 1 without a normal.
fn lit(normal: &[f32; 3]) -> f32 {
    let facing: f32 = normal.iter().zip(LIGHT).map(|(n, l)| n * l).sum();
    if facing.is_nan() { 1.0 } else { AMBIENT + (1.0 - AMBIENT) * facing.max(0.0) }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::grid::{Raster, View};

    /// A map of one row with these depths.
    fn row(depths: &[f32]) -> DepthMap {
        let axis = |count| Axis { first: 0.0, pitch: 0.1, count };
        let raster = Raster { view: View::Orthographic, x: axis(depths.len()), y: axis(1) };
        DepthMap::new(raster, layer(depths))
    }

    fn layer(depths: &[f32]) -> DepthLayer {
        let strength = depths.iter().map(|z| if z.is_nan() { 0.0 } else { 1.0 }).collect();
        let confidence = Some(depths.iter().map(|z| 10.0 * z).collect());
        DepthLayer { depth: depths.to_vec(), strength, confidence, ..DepthLayer::default() }
    }

    #[test]
    fn large_maps_are_subsampled() {
        let data = packed(&row(&[1.0; 1300]), None).unwrap();
        assert_eq!(data["reduced"], 3);
        assert_eq!(data["x"], json!({ "first": 0.0, "pitch": 0.1 * 3.0, "count": 434 }));
        assert_eq!(data["y"]["count"], 1);
        assert_eq!(data["picked"]["depth"], json!(pack_floats(&[1.0; 434])));
    }

    #[test]
    fn returns_are_packed_where_there_are_several() {
        let nothing = f32::NAN;
        let mut map = row(&[1.0, 2.5, nothing]);
        map.returns = vec![layer(&[1.0, 2.0, nothing]), layer(&[nothing; 3])];
        assert!(packed(&map, None).unwrap().get("returns").is_none(), "only one return anywhere");
        map.returns[1] = layer(&[1.5, 2.5, nothing]);
        map.returns.push(layer(&[nothing; 3]));
        let data = packed(&map, Some(&row(&[1.0, 2.25, 3.0]))).unwrap();
        let returns = data["returns"].as_array().unwrap();
        assert_eq!(returns.len(), 2, "an empty return is left out");
        for (packed, depth, same, error) in [
            (&returns[0], [nothing, 2.0, nothing], [1, 0, 0], [nothing, -0.25, nothing]),
            (&returns[1], [1.5, nothing, nothing], [0, 1, 0], [0.5, nothing, nothing]),
        ] {
            assert_eq!(packed["depth"], json!(pack_floats(&depth)), "only what is not the picked return");
            assert_eq!(packed["same"], json!(pack(&same)));
            assert_eq!(packed["error"], json!(pack_floats(&error)));
            assert_eq!(packed["confidence"], json!(pack_floats(&depth.map(|z| 10.0 * z))));
        }
    }

    #[test]
    fn surfaces_are_shaded_by_their_normals_where_they_have_some() {
        let mut map = row(&[1.0; 4]);
        assert!(packed(&map, None).unwrap()["picked"].get("shading").is_none());
        let up = [0.0, -0.6, -0.8];
        map.picked.normal = Some(vec![[f32::NAN; 3], [0.0, 0.0, -1.0], up, [0.0, 0.6, -0.8]]);
        let data = packed(&map, Some(&map)).unwrap();
        assert!(data["picked"]["shading"].is_string() && data["true_shading"].is_string());
        let front = AMBIENT + (1.0 - AMBIENT) * 0.703_56;
        assert!((lit(&[0.0, 0.0, -1.0]) - front).abs() < 1e-6 && lit(&[f32::NAN; 3]) == 1.0);
        assert!(lit(&up) > front && lit(&[0.0, 0.6, -0.8]) < front && lit(&[0.9, 0.4, -0.1]) >= AMBIENT);
    }
}
