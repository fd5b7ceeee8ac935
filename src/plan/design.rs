//! What an array and a band are suited for, and how to improve them: the designer's half of a plan.

use super::beam::{Beam, Sidelobes};
use super::resolution::WindowWeights;
use super::{alias_free_pitch, nice};
use crate::acquisition::{Detection, Instrument};
use crate::grid::Grid;
use crate::reconstruct::Window;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Sidelobes of scattered microphones above this are worth a warning, dB: depth maps accept returns down to −14 dB.
const LOUD: f64 = -14.0;

/// Resolution at one depth, in front of the array's centre; lengths in m.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct AtDepth {
    /// z, m.
    pub depth: f64,
    /// λ_c z/D along x and y.
    pub lateral_resolution: [Option<f64>; 2],
    /// Full widths of a point at −3 dB along x, y and z, with the window.
    pub widths: [Option<f64>; 3],
    /// λ_min z/d: the smallest offset of a bright point's first grating lobe. Lattices only.
    #[serde(rename = "ghost_offset")]
    pub grating_lobe_offset: Option<f64>,
}

/// Largest lengths that are not ambiguous, m.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Ambiguity {
    /// As a path length, m: c/δf in quadrature (of the paths' span), c/2δf in phase (of the longest).
    pub path: [f64; 2],
    /// As a range, m: half of each.
    pub range: [f64; 2],
    /// Whether the second applies (in-phase data) rather than the first.
    pub in_phase: bool,
    /// The length of the kind that applies, of this grid, m.
    pub used: f64,
}

/// Whether bright points have grating lobes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// d ≤ λ_min/2: nowhere.
    AliasFree,
    /// d ≤ λ_min z/X: not within this grid.
    AliasFreeHere,
    /// Within this grid.
    #[serde(rename = "ghosts")]
    GratingLobes,
    /// No lattice, so no grating lobes, but sidelobes.
    Scattered,
}

impl Verdict {
    /// In words, short enough for a table.
    pub const fn word(self) -> &'static str {
        match self {
            Self::AliasFree => "free",
            Self::AliasFreeHere => "free here",
            Self::GratingLobes => "grating lobes",
            Self::Scattered => "no lattice",
        }
    }
}

/// Aliasing by the pitch and by the array factor.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Aliasing {
    /// The verdict; of lattices by their pitch.
    pub verdict: Verdict,
    /// The larger pitch of a lattice, m.
    pub pitch: Option<f64>,
    /// λ_min/2: free of grating lobes everywhere, m.
    pub pitch_free_everywhere: f64,
    /// λ_min z/X: free of grating lobes within this grid, m; `None` for a grid without width.
    pub pitch_free_here: Option<f64>,
    /// About −20 log₁₀ max(1, (N − 1) B/f_c), dB: the first grating lobe of a lattice without a window.
    pub rule_db: Option<f64>,
    /// By the array factor, with the window, within this grid.
    pub sidelobes: Sidelobes,
}

/// A change that would fix something.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Suggestion {
    /// What it fixes: "aliasing", "ambiguity", "voxels" or "speed".
    #[serde(rename = "mends")]
    pub fixes: &'static str,
    /// Overrides of the run file, each `table.key=value`, to be made together.
    pub set: Vec<String>,
    /// What else changes.
    pub effect: String,
}

/// The designer's half of a plan.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Design {
    /// Near, middle and far.
    pub depths: [AtDepth; 3],
    /// `None` unless there are several frequencies at even steps.
    pub ambiguity: Option<Ambiguity>,
    /// Grating lobes and sidelobes.
    pub aliasing: Aliasing,
    /// Voxel pitch along x, y and z that loses little of |Â|, m.
    pub voxel_pitch: [f64; 3],
    /// How to fix each warning; those that fix the same are alternatives.
    pub suggestions: Vec<Suggestion>,
    /// Warnings in addition to [`super::Plan::warnings`].
    pub warnings: Vec<String>,
}

/// Computes a design. Cost: a fraction of a second for any array, most of it for sidelobes; [`Sidelobes::skipped`] says which
/// were not searched for.
pub fn design(instrument: &Instrument, grid: &Grid, window: Window) -> Design {
    let near = grid.z.first.max(1e-3);
    let depths = [near, f64::midpoint(near, grid.z.last()), grid.z.last().max(near)];
    let centre = instrument.array.centre();
    // Several loudspeakers, or a pair, see what another array sees of one, or a scan.
    let seen = instrument.equivalent();
    let pitch = largest_pitch(&seen).map(|(pitch, _)| pitch);
    let reduced = seen.shortest_wavelength() / seen.geometry.scanned_legs();
    let aliasing = aliasing(&seen, grid, window);
    let mut warnings = Vec::new();
    if let (Verdict::Scattered, Some(peak)) =
        (aliasing.verdict, aliasing.sidelobes.peak_db.filter(|db| *db > LOUD))
    {
        let [x, y] = aliasing.sidelobes.peak_offset.map(|offset| offset * near);
        warnings.push(format!(
            "{} scattered microphones have sidelobes of up to {peak:.0} dB within this grid, for example at an offset of \
             {x:.2}, {y:.2} m from a bright point at its nearest depth; more microphones or a smaller extent lower them",
            seen.array.len()
        ));
    }
    let suggestions = [
        // What it suggests is an array of microphones.
        if instrument.has_virtual_array() { Vec::new() } else { fix_aliasing(instrument, &aliasing, near) },
        fix_ambiguity(instrument, grid),
        fix_voxels(instrument, grid),
    ];
    let weights = WindowWeights::of(instrument, window);
    Design {
        depths: depths.map(|depth| AtDepth {
            depth,
            lateral_resolution: instrument.lateral_resolution((depth - centre.z).abs()),
            widths: instrument.widths_by(DVec3::new(centre.x, centre.y, depth), &weights, 3.0),
            grating_lobe_offset: pitch.map(|pitch| reduced * depth / pitch),
        }),
        ambiguity: ambiguity(instrument, grid),
        aliasing,
        voxel_pitch: instrument.advised_pitch(near),
        suggestions: suggestions.into_iter().flatten().collect(),
        warnings,
    }
}

/// The larger pitch of a lattice and the microphones along it.
fn largest_pitch(instrument: &Instrument) -> Option<(f64, usize)> {
    let lattice = instrument.array.lattice()?;
    let axes = [lattice.x, lattice.y].into_iter().filter(|axis| axis.count > 1);
    axes.max_by(|a, b| a.pitch.total_cmp(&b.pitch)).map(|axis| (axis.pitch, axis.count))
}

/// Largest difference along x and y of the direction sines at which the array's centre sees two points of a grid.
fn reach_of(instrument: &Instrument, grid: &Grid) -> [f64; 2] {
    let centre = instrument.array.centre();
    let ends = |first: f64, last: f64, origin: f64| [first - origin, last - origin];
    let (x, y) = (ends(grid.x.first, grid.x.last(), centre.x), ends(grid.y.first, grid.y.last(), centre.y));
    let z = ends(grid.z.first, grid.z.last(), centre.z).map(|z| z.abs().max(1e-3));
    let span = |along: [f64; 2], across: [f64; 2]| {
        // Where the other coordinate passes 0 the sine is largest.
        let nearest = 0.0_f64.clamp(across[0], across[1]);
        let sines = along.into_iter().flat_map(|a| {
            [across[0], across[1], nearest]
                .into_iter()
                .flat_map(move |b| z.map(move |z| a / DVec3::new(a, b, z).length()))
        });
        let (low, high) = sines.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), s| (l.min(s), h.max(s)));
        high - low
    };
    [span(x, y), span(y, x)]
}

fn aliasing(instrument: &Instrument, grid: &Grid, window: Window) -> Aliasing {
    let sidelobes = Beam::new(instrument, window).sidelobes(reach_of(instrument, grid));
    let everywhere = instrument.shortest_wavelength() / instrument.geometry.scanned_legs() / 2.0;
    let width = (grid.x.last() - grid.x.first).max(grid.y.last() - grid.y.first);
    let here = alias_free_pitch(instrument, grid.z.first.max(1e-3), width);
    let largest = largest_pitch(instrument);
    let verdict = match largest {
        _ if instrument.array.lattice().is_none() => Verdict::Scattered,
        Some((pitch, _)) if pitch > here * (1.0 + 1e-9) => Verdict::GratingLobes,
        Some((pitch, _)) if pitch > everywhere * (1.0 + 1e-9) => Verdict::AliasFreeHere,
        _ => Verdict::AliasFree,
    };
    Aliasing {
        verdict,
        pitch: largest.map(|(pitch, _)| pitch),
        pitch_free_everywhere: everywhere,
        pitch_free_here: (here < f64::MAX).then_some(here),
        rule_db: largest.map(|(_, count)| {
            let smear = (count - 1) as f64 * instrument.sweep.bandwidth() / instrument.sweep.centre();
            -20.0 * smear.max(1.0).log10()
        }),
        sidelobes,
    }
}

fn ambiguity(instrument: &Instrument, grid: &Grid) -> Option<Ambiguity> {
    let step = instrument.sweep.step().filter(|_| instrument.sweep.len() > 1)?;
    let path = [instrument.sound_speed / step, instrument.sound_speed / (2.0 * step)];
    Some(Ambiguity {
        path,
        range: path.map(|path| path / 2.0),
        in_phase: instrument.detection == Detection::InPhase,
        used: instrument.ambiguous_length(instrument.path_bounds(grid)),
    })
}

fn fix_aliasing(instrument: &Instrument, aliasing: &Aliasing, near: f64) -> Vec<Suggestion> {
    let (Some(lattice), Verdict::GratingLobes, Some(free)) =
        (instrument.array.lattice(), aliasing.verdict, aliasing.pitch_free_here)
    else {
        return Vec::new();
    };
    let axes = [lattice.x, lattice.y];
    let extent = axes.map(|axis| axis.pitch * (axis.count - 1) as f64);
    // Slightly less than the pitch that is just free of grating lobes, so that rounding the numbers below cannot undo it.
    let count = extent.map(|extent| (extent / (free * (1.0 - 1e-6))).ceil() as usize + 1);
    let shorter: [f64; 2] =
        std::array::from_fn(|i| (extent[i]).min((free * (axes[i].count - 1) as f64 * 1e4).floor() / 1e4));
    let resolution = |extent: [f64; 2]| {
        let widest = extent[0].max(extent[1]);
        1e3 * instrument.wavelength() * near / (widest * instrument.geometry.scanned_legs())
    };
    let extent_set = |extent: [f64; 2]| format!("array.extent=[{}, {}]", nice(extent[0]), nice(extent[1]));
    let mut suggestions = Vec::new();
    if count[0].saturating_mul(count[1]) <= 1 << 20 {
        suggestions.push(Suggestion {
            fixes: "aliasing",
            set: vec![format!("array.count=[{}, {}]", count[0], count[1]), extent_set(extent)],
            effect: format!(
                "{} microphones instead of {}, same resolution",
                count[0] * count[1],
                instrument.array.len()
            ),
        });
    }
    if shorter.iter().zip(axes).all(|(extent, axis)| *extent > 0.0 || axis.count == 1) {
        suggestions.push(Suggestion {
            fixes: "aliasing",
            set: vec![extent_set(shorter)],
            effect: format!(
                "the same number of microphones; lateral resolution {:.0} instead of {:.0} mm at the nearest depth",
                resolution(shorter),
                resolution(extent)
            ),
        });
    }
    if axes.iter().all(|axis| axis.count > 1) {
        let rms_db = -10.0 * (instrument.array.len() as f64).log10();
        suggestions.push(Suggestion {
            fixes: "aliasing",
            set: vec!["array.layout=spiral".to_owned()],
            effect: format!(
                "no grating lobes but sidelobes everywhere, with a mean power of about {rms_db:.0} dB at one frequency"
            ),
        });
    }
    suggestions
}

fn fix_ambiguity(instrument: &Instrument, grid: &Grid) -> Vec<Suggestion> {
    let (Some(unambiguous), Some(step)) = (instrument.unambiguous_path(), instrument.sweep.step()) else {
        return Vec::new();
    };
    let used = instrument.ambiguous_length(instrument.path_bounds(grid));
    if used <= unambiguous {
        return Vec::new();
    }
    let (band, most) = (instrument.sweep.bandwidth(), step * unambiguous / used);
    // A round step that divides the band, or else any that does.
    let power = 10_f64.powf(most.log10().floor());
    let round = [5.0, 4.0, 2.5, 2.0, 1.0, 0.5, 0.4, 0.25, 0.2, 0.1]
        .into_iter()
        .map(|factor| factor * power)
        .find(|step| *step <= most && ((band / step).round() * step - band).abs() < 1e-9 * band);
    let step = round.unwrap_or_else(|| band / (band / most).ceil());
    let frequencies = (band / step).round() as usize + 1;
    vec![Suggestion {
        fixes: "ambiguity",
        set: vec![format!("sweep.step={}", nice(step))],
        effect: format!("{frequencies} frequencies instead of {}", instrument.sweep.len()),
    }]
}

fn fix_voxels(instrument: &Instrument, grid: &Grid) -> Vec<Suggestion> {
    let advised = instrument.advised_pitch(grid.z.first);
    let axes = [grid.x, grid.y, grid.z];
    let coarse = |i: usize| axes[i].count > 1 && axes[i].pitch > 1.05 * advised[i];
    if !(0..3).any(coarse) {
        return Vec::new();
    }
    let pitch: [f64; 3] = std::array::from_fn(|i| if coarse(i) { advised[i] } else { axes[i].pitch });
    let more: f64 = (0..3).map(|i| axes[i].pitch / pitch[i]).product();
    vec![Suggestion {
        fixes: "voxels",
        set: vec![format!("grid.pitch=[{}, {}, {}]", nice(pitch[0]), nice(pitch[1]), nice(pitch[2]))],
        effect: format!("half a resolution cell at the nearest depth; {more:.1} times as many voxels"),
    }]
}

#[cfg(test)]
mod tests {
    use super::super::{plan, tests::test_instrument};
    use super::*;
    use crate::acquisition::MicArray;
    use crate::grid::Axis;

    fn grid(half: f64, z: [f64; 2]) -> Grid {
        let lateral = Axis { first: -half, pitch: half / 25.0, count: 51 };
        Grid {
            x: lateral,
            y: lateral,
            z: Axis { first: z[0], pitch: 0.008, count: ((z[1] - z[0]) / 0.008) as usize + 1 },
        }
    }

    #[test]
    fn the_verdict_follows_the_pitch() {
        for (count, half, verdict) in [
            (15, 0.6, Verdict::GratingLobes),
            (63, 0.1, Verdict::AliasFreeHere),
            (127, 0.6, Verdict::AliasFree),
        ] {
            let instrument = &test_instrument(count, 1.0, 40.0, Detection::Quadrature);
            let grid = grid(half, [1.2, 2.0]);
            let design = design(instrument, &grid, Window::None);
            assert_eq!(design.aliasing.verdict, verdict, "{count}");
            let warned = plan(instrument, &grid).warnings.iter().any(|w| w.contains("alias"));
            assert_eq!(warned, verdict == Verdict::GratingLobes);
            let fixes = design.suggestions.iter().filter(|s| s.fixes == "aliasing").count();
            assert_eq!(fixes, if warned { 3 } else { 0 });
        }
    }

    #[test]
    fn ambiguity_is_reported_for_both_detections_and_fixed_by_a_round_step() {
        let instrument = &test_instrument(31, 1.0, 200.0, Detection::InPhase);
        let design = design(instrument, &grid(0.6, [1.2, 2.0]), Window::Taylor);
        let ambiguity = design.ambiguity.expect("even steps");
        assert_eq!((ambiguity.path, ambiguity.range), ([1.715, 0.8575], [0.8575, 0.42875]));
        assert!(ambiguity.in_phase && ambiguity.used > ambiguity.path[1]);
        let fix = design.suggestions.iter().find(|s| s.fixes == "ambiguity").expect("a step");
        assert_eq!(fix.set, ["sweep.step=25"], "{fix:?}");
    }

    #[test]
    fn scattered_arrays_are_rated_by_their_array_factor() {
        let instrument = &test_instrument(16, 1.0, 40.0, Detection::Quadrature);
        let array = MicArray::spiral(256, [1.0; 2], DVec3::ZERO).expect("a spiral");
        let instrument = instrument.clone().with_array(array);
        let design = design(&instrument, &grid(0.6, [1.2, 2.0]), Window::Taylor);
        assert_eq!(design.aliasing.verdict, Verdict::Scattered);
        assert!(design.aliasing.pitch.is_none() && design.depths[0].grating_lobe_offset.is_none());
        let sidelobes = design.aliasing.sidelobes;
        assert!(sidelobes.peak_db.expect("sidelobes") < -15.0, "{sidelobes:?}");
        assert!((sidelobes.mean_db.expect("sidelobes") + 24.0).abs() < 3.0, "{sidelobes:?}");
    }
}
