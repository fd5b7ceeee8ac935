//! The acoustic properties of a glTF material: from its opacity, its transmission, or the program's own keys in its extras.

use ::gltf::json;
use json::material::AlphaMode;
use json::validation::Checked;

use super::super::material::Material;
use super::container::Document;
use crate::error::{Error, Result};
use crate::text::quoted;

/// The material as the file describes it: extras override transmission, and transmission overrides alpha.
pub(super) fn material(document: &Document<'_>, index: usize, material: &json::Material) -> Result<Material> {
    let name = material.name.clone().unwrap_or_default();
    let place = || document.place("material", index, material.name.as_ref());
    let alpha = f64::from(material.pbr_metallic_roughness.base_color_factor.0[3]);
    // An opacity of 0.4 should not become 0.4000000059604645: an f32 has only seven digits.
    let alpha = seven_digits(alpha);
    let cutoff = material.alpha_cutoff.map_or(0.5, |cutoff| f64::from(cutoff.0));
    let mut result = match material.alpha_mode {
        Checked::Valid(AlphaMode::Blend) => Material::of_opacity(&name, alpha, "glTF alpha"),
        // Below its cutoff a masked surface is not drawn at all.
        Checked::Valid(AlphaMode::Mask) if alpha < cutoff => Material::of_opacity(&name, 0.0, "glTF alpha"),
        Checked::Valid(_) => Material::opaque(&name),
        Checked::Invalid => return Err(Error::input(place(), "alphaMode must be OPAQUE, MASK or BLEND")),
    };
    if result.source == "glTF alpha"
        && alpha == 1.0
        && material.pbr_metallic_roughness.base_color_texture.is_some()
    {
        document.file.observer.warn(&format!(
            "{}: its opacity is in a texture, which is not read; it counts as opaque unless a [[materials]] rule \
             sets its transmittance",
            place()
        ));
    }
    let transmission = material.extensions.as_ref().and_then(|e| e.transmission.as_ref());
    if let Some(transmission) = transmission {
        let t = seven_digits(f64::from(transmission.transmission_factor.0));
        if t > 0.0 {
            // Even all of the light: it is refracted by something that is there.
            result = Material::of_opacity(&name, (1.0 - t).max(f64::MIN_POSITIVE), "glTF transmission");
        }
    }
    if let Some(extras) = &material.extras {
        let extras: serde_json::Value = serde_json::from_str(extras.get()).unwrap_or_default();
        for (key, share) in [
            ("acoustic_reflectance", &mut result.reflectance),
            ("acoustic_transmittance", &mut result.transmittance),
        ] {
            if let Some(value) = extras.get(key) {
                *share = value.as_f64().ok_or_else(|| {
                    let problem = format!(
                        "extras: `{key}` is {}; expected a number from 0 to 1",
                        quoted(&value.to_string())
                    );
                    Error::input(place(), problem)
                })?;
                "glTF extras".clone_into(&mut result.source);
            }
        }
    }
    // `check` names the material; the file and the place in it are added here.
    result.check().map_err(|error| error.at(format!("{} ({})", place(), result.source)))?;
    Ok(result)
}

fn seven_digits(value: f64) -> f64 {
    (value * 1e7).round() / 1e7
}
