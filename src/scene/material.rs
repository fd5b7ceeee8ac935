//! What a surface does to sound, and where the values come from: a material rule or the mesh file.

mod common;

pub use common::CommonMaterial;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;

use super::files::list_names;
use crate::error::{Error, Result};
use crate::progress::Observer;
use crate::text::quoted;
use serde::{Deserialize, Serialize};

/// How the source of a material ends that only its transparency to light tells of.
const AS_GLASS: &str = ", as glass";

/// How a surface reflects and transmits the amplitude of sound; equal for both sides, all angles and all frequencies.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Material {
    /// Name in the file, or that of the first node or object that uses it.
    pub name: String,
    /// Share of the amplitude that is reflected, 0..1.
    pub reflectance: f64,
    /// Share of the amplitude that one crossing transmits, 0..1.
    pub transmittance: f64,
    /// Source of the values: "rule `glass*`", "glTF extras", "glTF transmission, as glass", "glTF alpha, as glass",
    /// "MTL d, as glass", "MTL Tr, as glass", "part's material, wood", "default".
    pub source: String,
}

impl Material {
    /// An opaque surface that reflects everything: the default.
    pub(super) fn opaque(name: &str) -> Self {
        Self { name: name.to_owned(), reflectance: 1.0, transmittance: 0.0, source: "default".to_owned() }
    }

    /// A surface of this opacity to light, which says little about sound: what lets some light through counts as glass, a
    /// strong reflector, and what lets all of it through, as invisible helpers of modelling programs do, is not there.
    pub(super) fn of_opacity(name: &str, opacity: f64, source: &str) -> Self {
        let ([reflectance, transmittance], source) = match opacity {
            o if o <= 0.0 => ([0.0, 1.0], source.to_owned()),
            o if o < 1.0 => (CommonMaterial::Glass.shares(), format!("{source}{AS_GLASS}")),
            _ => ([1.0, 0.0], source.to_owned()),
        };
        Self { name: name.to_owned(), reflectance, transmittance, source }
    }

    /// Refuses shares outside 0..1.
    pub(super) fn check(&self) -> Result<()> {
        let place = || format!("material `{}` ({})", quoted(&self.name), self.source);
        check_share(place, "reflectance", self.reflectance)?;
        check_share(place, "transmittance", self.transmittance)
    }
}

/// Refuses a share of amplitude outside 0..1 (or NaN).
fn check_share(place: impl Fn() -> String, what: &str, value: f64) -> Result<()> {
    if (0.0..=1.0).contains(&value) {
        return Ok(());
    }
    Err(Error::input(place(), format!("{what} is {value}; expected a share of the amplitude, 0 to 1")))
}

/// Overrides the materials, nodes and objects whose name matches.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaterialRule {
    /// Pattern: `*` matches any run of characters, `?` any single one; upper and lower case differ.
    pub name: String,
    /// What it is made of; `reflectance` and `transmittance` change single values of it.
    pub material: Option<CommonMaterial>,
    /// Share of the amplitude that is reflected, 0..1; `None` for the file's value.
    pub reflectance: Option<f64>,
    /// Share of the amplitude that one crossing transmits, 0..1; `None` for the file's value.
    pub transmittance: Option<f64>,
}

/// Whether `name` matches `pattern` with `*` and `?`. Backtracks to the last `*` only, so it takes
/// `O(pattern × name)` at worst.
fn matches(pattern: &str, name: &str) -> bool {
    let (pattern, name): (Vec<char>, Vec<char>) = (pattern.chars().collect(), name.chars().collect());
    let (mut p, mut n) = (0, 0);
    let mut star = None;
    while n < name.len() {
        match pattern.get(p) {
            Some('*') => {
                star = Some((p, n));
                p += 1;
            }
            Some(&c) if c == '?' || c == name[n] => {
                p += 1;
                n += 1;
            }
            _ => {
                // Let the last star match one character more, and try again.
                let Some((star_p, star_n)) = star else { return false };
                star = Some((star_p, star_n + 1));
                p = star_p + 1;
                n = star_n + 1;
            }
        }
    }
    pattern[p..].iter().all(|&c| c == '*')
}

/// Collects the materials in use while a file is read: what the file declares, overridden by the rules.
#[derive(Default)]
pub(super) struct Palette<'a> {
    rules: &'a [MaterialRule],
    used: Vec<bool>,
    declared: Vec<Material>,
    /// Keyed by declared material and rule, so that a thousand nodes of one kind share one entry.
    assigned: BTreeMap<(Option<usize>, Option<usize>), u32>,
    materials: Vec<Material>,
    names: BTreeSet<String>,
    part: PartInHand<'a>,
}

/// The part of an assembly to which the next surfaces belong.
#[derive(Default, Clone, Copy)]
struct PartInHand<'a> {
    /// Its name; empty where there is no assembly.
    name: &'a str,
    /// What it is made of unless a rule says otherwise.
    material: Option<CommonMaterial>,
    /// Its first material.
    first: usize,
}

impl<'a> Palette<'a> {
    /// # Errors
    /// A rule without a name, without a value, or with one outside 0..1.
    pub(super) fn new(rules: &'a [MaterialRule]) -> Result<Self> {
        for (i, rule) in rules.iter().enumerate() {
            if rule.name.is_empty() {
                let place = format!("material rule {}", i + 1);
                return Err(Error::input(place, "has no name; `*` matches every name"));
            }
            let place = || format!("material rule `{}`", quoted(&rule.name));
            if rule.material.is_none() && rule.reflectance.is_none() && rule.transmittance.is_none() {
                let problem = "sets neither material nor reflectance nor transmittance; set at least one";
                return Err(Error::input(place(), problem));
            }
            for (what, value) in [("reflectance", rule.reflectance), ("transmittance", rule.transmittance)] {
                check_share(place, what, value.unwrap_or(0.0))?;
            }
        }
        Ok(Self { rules, used: vec![false; rules.len()], ..Self::default() })
    }

    /// What follows is read of another file, which is the part of this name; rules match that name too.
    pub(super) fn begin_part(&mut self, name: &'a str, material: Option<CommonMaterial>) {
        self.declared.clear();
        self.assigned.clear();
        self.part = PartInHand { name, material, first: self.materials.len() };
    }

    /// Names the materials of the part after it, since other parts may have some of the same names.
    pub(super) fn end_part(&mut self) {
        let PartInHand { name, first, .. } = self.part;
        match &mut self.materials[first..] {
            [only] => name.clone_into(&mut only.name),
            several => several.iter_mut().for_each(|one| one.name = format!("{name}/{}", one.name)),
        }
    }

    /// Records a material of the file; [`Palette::assign`] refers to them by their order.
    pub(super) fn declare(&mut self, material: Material) {
        self.declared.push(material);
    }

    /// The material of a surface, from the declared material (if the file gives one) and the name of the node or object
    /// it belongs to (may be empty).
    pub(super) fn assign(&mut self, declared: Option<usize>, owner: &str) -> u32 {
        let mut material = declared.map_or_else(|| Material::opaque(""), |i| self.declared[i].clone());
        let part = self.part;
        for name in [material.name.as_str(), owner, part.name] {
            if !name.is_empty() && !self.names.contains(name) {
                self.names.insert(name.to_owned());
            }
        }
        let rule = self.rules.iter().position(|rule| {
            let hit = |name: &str| !name.is_empty() && matches(&rule.name, name);
            // A lone star matches everything, even what has no name.
            rule.name == "*" || hit(&material.name) || hit(owner) || hit(part.name)
        });
        if let Some(&index) = self.assigned.get(&(declared, rule)) {
            return index;
        }
        if material.name.is_empty() {
            material.name = if owner.is_empty() { "unnamed".to_owned() } else { owner.to_owned() };
        }
        if let Some(i) = rule {
            self.used[i] = true;
            let rule = &self.rules[i];
            if let Some(common) = rule.material {
                [material.reflectance, material.transmittance] = common.shares();
            }
            material.reflectance = rule.reflectance.unwrap_or(material.reflectance);
            material.transmittance = rule.transmittance.unwrap_or(material.transmittance);
            let of = rule.material.map(|common| format!(", {common}")).unwrap_or_default();
            material.source = format!("rule `{}`{of}", quoted(&rule.name));
        } else if let Some(common) = part.material {
            [material.reflectance, material.transmittance] = common.shares();
            material.source = format!("part's material, {common}");
        }
        let index = self.materials.len() as u32;
        self.materials.push(material);
        self.assigned.insert((declared, rule), index);
        index
    }

    /// The materials in use. Warns of rules that matched nothing, and of materials of which only the transparency to light
    /// is known.
    pub(super) fn finish(self, place: impl Display, observer: &dyn Observer) -> Vec<Material> {
        let warn = |message: std::fmt::Arguments<'_>| observer.warn(&format!("{place}: {message}"));
        let as_glass = self.materials.iter().filter(|material| material.source.ends_with(AS_GLASS));
        let as_glass: BTreeSet<String> = as_glass.map(|material| material.name.clone()).collect();
        if !as_glass.is_empty() {
            warn(format_args!(
                "{} let light through, which says nothing about sound; they count as glass, a strong reflector, unless a \
                 [[materials]] rule or glTF extras (acoustic_reflectance, acoustic_transmittance) say otherwise",
                list_names(&as_glass)
            ));
        }
        let names = if self.names.is_empty() { "no names".to_owned() } else { list_names(&self.names) };
        for (rule, _) in self.rules.iter().zip(&self.used).filter(|(_, used)| !**used) {
            warn(format_args!(
                "material rule `{}` matches no material, node or object (or earlier rules matched them all); there are \
                 {names}",
                quoted(&rule.name)
            ));
        }
        self.materials
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::named::assert_names;
    use crate::progress::Silent;

    #[test]
    fn patterns_match_as_in_a_shell() {
        for (pattern, name) in
            [("glass*", "glass"), ("glass*", "glass door"), ("*a*b?", "xxaybz"), ("?", "é"), ("**", "")]
        {
            assert!(matches(pattern, name), "{pattern} {name}");
        }
        for (pattern, name) in [("glass*", "Glass"), ("?", ""), ("a?c", "ac"), ("a*b", "abc"), ("", "a")] {
            assert!(!matches(pattern, name), "{pattern} {name}");
        }
        let hostile = "*a".repeat(40);
        assert!(!matches(&hostile, &"a".repeat(39)));
    }

    #[test]
    fn the_first_matching_rule_wins_and_keeps_what_it_does_not_set() {
        let rules = [
            MaterialRule { name: "pane*".into(), transmittance: Some(0.9), ..MaterialRule::default() },
            MaterialRule {
                name: "glass".into(),
                reflectance: Some(0.1),
                transmittance: Some(0.2),
                material: None,
            },
            MaterialRule {
                name: "drape".into(),
                material: Some(CommonMaterial::Curtain),
                transmittance: Some(0.5),
                ..MaterialRule::default()
            },
        ];
        let mut palette = Palette::new(&rules).unwrap();
        palette.declare(Material::of_opacity("glass", 0.4, "glTF alpha"));
        let [a, b, c] = ["pane 1", "pane 2", "cup"].map(|owner| palette.assign(Some(0), owner));
        let [wall, drape] = ["wall", "drape"].map(|owner| palette.assign(None, owner));
        let materials = palette.finish("a.obj", &Silent);
        assert_eq!(a, b);
        let shares = |i: u32| (materials[i as usize].reflectance, materials[i as usize].transmittance);
        assert_eq!(shares(a), (0.99, 0.9));
        assert_eq!(shares(c), (0.1, 0.2));
        assert_eq!(shares(wall), (1.0, 0.0));
        assert_eq!(shares(drape), (0.58, 0.5));
        assert_eq!(materials[drape as usize].source, "rule `drape`, curtain");
        assert_eq!(materials[a as usize].source, "rule `pane*`");
        assert_eq!(materials[wall as usize].source, "default");
    }

    #[test]
    fn rules_that_say_nothing_or_too_much_are_refused() {
        let refused = |rule: MaterialRule| Palette::new(&[rule]).err().unwrap().to_string();
        let rule = |name: &str, reflectance| MaterialRule {
            name: name.into(),
            reflectance,
            ..MaterialRule::default()
        };
        assert_names(refused(rule("a", None)), &["`a`", "reflectance", "transmittance"]);
        assert_names(refused(rule("", Some(1.0))), &["name"]);
        assert_names(refused(rule("a", Some(1.5))), &["`a`", "reflectance", "1.5", "0 to 1"]);
        assert_names(refused(rule("a", Some(f64::NAN))), &["`a`", "reflectance", "NaN"]);
    }
}
