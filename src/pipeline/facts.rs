//! The metadata of output files: named attributes for EXR, VTI, NRRD and VDB, JSON for npz.

use crate::acquisition::Instrument;
use crate::config::{RefineMethod, RunFile};
use crate::depth::ArraySidelobes;
use crate::export::{Attribute, Attributes, attributes_as_json, find_attribute};
use crate::grid::Grid;
use crate::plan::{Smear, near_sidelobe_db};
use crate::reconstruct::{Correlation, ReconstructionInfo};
use crate::wave::{Aperture, Geometry, GeometryKind, Interface, Motion, Resolution};
use glam::DVec3;
use serde_json::{Value, json};
use std::borrow::Cow;

/// The program and its version, as files name them.
pub(super) const PROGRAM: &str = concat!("holosonar ", env!("CARGO_PKG_VERSION"));

/// Everything needed to interpret and reproduce an image: `meta` in a volume's npz.
pub(super) fn image_facts(
    instrument: &Instrument,
    run: &RunFile,
    info: &ReconstructionInfo,
    sidelobes: ArraySidelobes,
) -> Value {
    let mut facts = instrument_facts(instrument, run);
    facts["method"] = json!(info.method);
    facts["error_bound"] = json!(info.error_bound);
    facts["incoherent_level"] = json!(info.incoherent_level);
    facts["outside_level"] = json!(info.outside_level);
    facts["sidelobes"] = json!(sidelobes);
    if let Some(correlation) = &info.correlation {
        facts["correlation"] = json!(correlation);
    }
    if let Some(refinement) = &info.refinement {
        facts["refinement"] = json!(refinement);
    }
    facts
}

/// The metadata of a measurement and of its run file.
pub(super) fn instrument_facts(instrument: &Instrument, run: &RunFile) -> Value {
    // Pairs that differ are known to a depth map as what they are seen as.
    let seen =
        if instrument.has_differing_pairs() { instrument.equivalent() } else { Cow::Borrowed(instrument) };
    let sources = instrument.sources();
    let source = if sources.is_empty() { DVec3::ZERO } else { instrument.viewpoint() };
    let mut facts = json!({
        "program": PROGRAM,
        "sound_speed": instrument.sound_speed,
        "start_frequency": instrument.sweep.start(),
        "bandwidth": instrument.sweep.bandwidth(),
        "frequency_step": instrument.sweep.step(),
        "frequencies": instrument.sweep.len(),
        "microphones": instrument.array.len(),
        "array_centre": seen.array.centre().to_array(),
        "array_extent": seen.array.extent().to_array(),
        "geometry": seen.geometry.kind(),
        "source": source.to_array(),
        "interface": instrument.interface,
        "detection": instrument.detection,
        // Samples of the other sign are conjugated on reading, so that every volume has the phases of this one.
        "phase_sign": 1,
        "window": run.reconstruct.window,
        "tolerance": run.reconstruct.tolerance,
        "range_resolution": instrument.range_resolution(),
        "seed": run.reflectors.seed,
        "run": run.to_json(),
    });
    if let (Some((low, high)), true) = (instrument.source_bounds(), sources.len() > 1) {
        // `source` is the middle of them.
        facts["sources"] = json!(sources.iter().map(DVec3::to_array).collect::<Vec<_>>());
        facts["source_extent"] = json!((high - low).to_array());
    }
    if let Geometry::Pair { offset } = seen.geometry {
        facts["source_offset"] = json!(offset.to_array());
    }
    facts
}

/// What of the paths and of the volume is beyond Eq. 13, in words.
pub(super) fn beyond_the_sum(run: &RunFile, instrument: &Instrument) -> Vec<String> {
    let interface = instrument.interface.map(|Interface { depth, sound_speed }| {
        format!(
            "sound travels at {sound_speed} m/s beyond z = {depth} m; paths bend there by Snell's law, without loss, and \
             shadows are cast along straight lines"
        )
    });
    let spreading = run.reconstruct.compensate.then(|| {
        "spreading undone in the volume: times the distances from speaker and array's centre, in m".to_owned()
    });
    let refined = run
        .refine_options()
        .map(|refine| format!("the volume refined: {}, at most {} steps", refine.solver, refine.steps));
    let moving = run.frame_motion().map(|Motion { velocity: DVec3 { x, y, z }, dwell, .. }| {
        format!("imaged in a frame that moves at ({x}, {y}, {z}) m/s, {dwell} s from one tone to the next")
    });
    interface.into_iter().chain(spreading).chain(refined).chain(moving).collect()
}

/// What each velocity of a scene does in the frame that is imaged.
pub(super) fn smears(run: &RunFile, instrument: &Instrument, grid: &Grid) -> Vec<Smear> {
    let frame = run.frame_motion().map_or(DVec3::ZERO, |motion| motion.velocity);
    let mut velocities = run.scene_velocities();
    if velocities.is_empty() {
        velocities.push(DVec3::ZERO);
    }
    let mut relative = Vec::new();
    for velocity in velocities.into_iter().map(|velocity| velocity - frame) {
        if velocity != DVec3::ZERO && !relative.contains(&velocity) {
            relative.push(velocity);
        }
    }
    let dwell = run.recording.dwell.unwrap_or(0.0);
    relative.into_iter().map(|velocity| Smear::of(instrument, grid, Motion::new(velocity, dwell))).collect()
}

/// How a volume was refined, from its metadata; `None` where they do not tell how it was computed at all.
pub(super) fn refined_by(meta: &Value) -> Option<RefineMethod> {
    meta.get("method")?;
    let solver = meta["refinement"]["solver"].as_str();
    Some(solver.and_then(|solver| solver.parse().ok()).unwrap_or(RefineMethod::None))
}

/// What a volume of Eq. 13 or a correlation tells apart.
pub(super) fn resolution(aperture: Aperture, correlation: Option<&Correlation>) -> Resolution {
    let resolution = Resolution::from(aperture);
    Resolution { range: correlation.map_or(resolution.range, Correlation::mean_resolution), ..resolution }
}

/// What a correlation tells apart in depth, from a volume's metadata, m; `None` of another volume.
pub(super) fn correlated_resolution(meta: &Value) -> Option<f64> {
    let [near, far]: [f64; 2] =
        serde_json::from_value(meta.get("correlation")?["depth_resolution"].clone()).ok()?;
    Some(f64::midpoint(near, far)).filter(|middle| *middle > 0.0 && middle.is_finite())
}

/// The sidelobes that depth has to expect.
pub(super) fn sidelobes(instrument: &Instrument, run: &RunFile) -> ArraySidelobes {
    let (window, instrument) = (run.reconstruct.window, &*instrument.equivalent());
    let near_db = near_sidelobe_db(instrument, window).unwrap_or(ArraySidelobes::default().near_db);
    let [sum, squares] =
        window.over_array(&instrument.array).iter().fold([0.0, 0.0], |[s, q], w| [s + w, q + w * w]);
    ArraySidelobes { near_db, mean_db: 10.0 * (squares / (sum * sum)).log10() }
}

/// The same from a volume's metadata.
pub(super) fn sidelobes_of(meta: &Value) -> Option<ArraySidelobes> {
    serde_json::from_value(meta["sidelobes"].clone()).ok()
}

/// The range resolution c/2B from a volume's metadata, m; beyond an interface, if there is one.
pub(crate) fn resolution_of(meta: &Value) -> Option<f64> {
    let number = |key: &str| meta.get(key).and_then(Value::as_f64).filter(|v| *v > 0.0);
    let beyond = meta.get("interface").and_then(|interface| interface.get("sound_speed")?.as_f64());
    Some(beyond.or_else(|| number("sound_speed"))? / (2.0 * number("bandwidth")?))
}

/// The aperture from a volume's metadata, if it is all there.
pub(super) fn aperture_of(meta: &Value) -> Option<Aperture> {
    let number = |key: &str| meta.get(key)?.as_f64();
    let vector = |key: &str| serde_json::from_value::<[f64; 3]>(meta.get(key)?.clone()).ok();
    let interface = serde_json::from_value(meta.get("interface").cloned().unwrap_or_default()).ok()?;
    aperture(number, vector, meta.get("geometry")?.as_str()?, interface)
}

/// The same from the attributes of a depth map.
pub(crate) fn aperture_of_file(attributes: &[(String, Attribute)]) -> Option<Aperture> {
    let of = |key: &str| find_attribute(attributes, &format!("sonar:{}", camel_case(key)));
    let number = |key: &str| match of(key)? {
        Attribute::Number(number) => Some(*number),
        Attribute::Integer(number) => Some(*number as f64),
        _ => None,
    };
    let vector = |key: &str| if let Attribute::Vector(vector) = of(key)? { Some(*vector) } else { None };
    let Attribute::Text(geometry) = of("geometry")? else { return None };
    let interface = match of("interface") {
        Some(Attribute::Text(interface)) => Some(serde_json::from_str(interface).ok()?),
        _ => None,
    };
    aperture(number, vector, geometry, interface)
}

fn aperture(
    number: impl Fn(&str) -> Option<f64>,
    vector: impl Fn(&str) -> Option<[f64; 3]>,
    geometry: &str,
    interface: Option<Interface>,
) -> Option<Aperture> {
    let positive = |key: &str| number(key).filter(|value| *value > 0.0 && value.is_finite());
    let start = positive("start_frequency")?;
    let geometry = match geometry.parse().ok()? {
        GeometryKind::FixedSource => Geometry::FixedSource { source: vector("source")?.into() },
        GeometryKind::Monostatic => Geometry::Monostatic,
        GeometryKind::Pair => Geometry::Pair { offset: vector("source_offset")?.into() },
    };
    let widened = vector("source_extent").map_or(DVec3::ZERO, DVec3::from);
    Some(Aperture {
        sound_speed: positive("sound_speed")?,
        band: [start, start + positive("bandwidth")?],
        centre: vector("array_centre")?.into(),
        extent: DVec3::from(vector("array_extent")?) + widened,
        geometry,
        interface,
    })
}

/// The metadata as attributes: `sound_speed` becomes `sonar:soundSpeed`, nested values become JSON text.
pub(super) fn attributes(facts: &Value) -> Attributes {
    let Some(facts) = facts.as_object() else { return Attributes::new() };
    facts
        .iter()
        .filter(|(_, value)| !value.is_null())
        .map(|(key, value)| {
            let attribute = match value {
                Value::String(text) => Attribute::Text(text.clone()),
                Value::Number(n) => n
                    .as_i64()
                    .map(Attribute::Integer)
                    .or_else(|| n.as_f64().map(Attribute::Number))
                    .unwrap_or_else(|| Attribute::Text(n.to_string())),
                Value::Array(list) => match list.iter().filter_map(Value::as_f64).collect::<Vec<_>>()[..] {
                    [x, y, z] => Attribute::Vector([x, y, z]),
                    _ => Attribute::Text(value.to_string()),
                },
                other => Attribute::Text(other.to_string()),
            };
            (format!("sonar:{}", camel_case(key)), attribute)
        })
        .collect()
}

/// The metadata of which these are the attributes; those of other programs keep their names.
pub fn facts_of_attributes(attributes: &[(String, Attribute)]) -> Value {
    let fact = |(name, value): (String, Value)| {
        let Some(name) = name.strip_prefix("sonar:") else { return (name, value) };
        // What was nested is JSON text.
        let nested = value.as_str().filter(|text| text.starts_with(['{', '[']));
        let nested = nested.and_then(|text| serde_json::from_str(text).ok());
        (snake_case(name), nested.unwrap_or(value))
    };
    match attributes_as_json(attributes) {
        Value::Object(facts) => Value::Object(facts.into_iter().map(fact).collect()),
        other => other,
    }
}

/// What can be resolved, from the metadata of an image or a truth.
pub fn resolution_in(meta: &Value) -> Option<Resolution> {
    let range = resolution_of(meta).or_else(|| meta["range_resolution"].as_f64())?;
    Some(Resolution { range, aperture: aperture_of(meta) })
}

/// `soundSpeed` → `sound_speed`, the inverse of [`camel_case`].
fn snake_case(name: &str) -> String {
    name.chars().fold(String::new(), |mut text, c| {
        if c.is_ascii_uppercase() {
            text.push('_');
        }
        text.push(c.to_ascii_lowercase());
        text
    })
}

/// `sound_speed` → `soundSpeed`, as EXR's own attributes are written.
fn camel_case(key: &str) -> String {
    let mut words = key.split('_');
    let mut name = words.next().unwrap_or_default().to_owned();
    for word in words {
        let mut letters = word.chars();
        name.extend(letters.next().map(|c| c.to_ascii_uppercase()));
        name.push_str(letters.as_str());
    }
    name
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn facts_become_attributes() {
        let facts = json!({"sound_speed": 343.5, "version": 1, "array_extent": [1.0, 0.5, 0.0], "seed": null,
            "run": {"a": 1}, "window": "taylor"});
        let expected: Attributes = vec![
            ("sonar:soundSpeed".into(), Attribute::Number(343.5)),
            ("sonar:version".into(), Attribute::Integer(1)),
            ("sonar:arrayExtent".into(), Attribute::Vector([1.0, 0.5, 0.0])),
            ("sonar:run".into(), Attribute::Text("{\"a\":1}".into())),
            ("sonar:window".into(), Attribute::Text("taylor".into())),
        ];
        assert_eq!(attributes(&facts), expected);
        // And back, without what was null.
        let back = facts_of_attributes(&expected);
        assert_eq!(
            back,
            json!({"sound_speed": 343.5, "version": 1, "array_extent": [1.0, 0.5, 0.0], "run": {"a": 1},
            "window": "taylor"})
        );
        let foreign = [("owner".to_owned(), Attribute::Text("[a]".into()))];
        assert_eq!(facts_of_attributes(&foreign), json!({"owner": "[a]"}));
    }

    #[test]
    fn a_resolution_needs_speed_and_bandwidth() {
        let d = resolution_of(&json!({"sound_speed": 343.0, "bandwidth": 10_000.0})).expect("both");
        assert!((d - 0.01715).abs() < 1e-12);
        assert!(resolution_of(&json!({"sound_speed": 343.0})).is_none());
        assert!(resolution_of(&json!({"sound_speed": 343.0, "bandwidth": 0.0})).is_none());
    }
}
