//! Tones of intervals of path length and of cells, whose error is measured together.

use crate::acquisition::simulate::SimulateOptions;
use crate::acquisition::simulate::terms::{ChebyshevNodes, LossModel};
use crate::acquisition::simulate::virtual_tones::{EquispacedTones, ToneDesign};
use crate::acquisition::{Instrument, Sweep};
use crate::wave::interval::{greater, phasor_f64};
use num_complex::Complex64;

/// Tones of intervals.
pub(super) struct IntervalTones {
    pub(super) tones: EquispacedTones,
    pub(super) loss_nodes: ChebyshevNodes,
    /// What nodes, and tones of cells, may err by.
    pub(super) tolerance: f64,
}

impl IntervalTones {
    /// Those of a design, if they meet the tolerance.
    pub(super) fn find(
        model: &LossModel,
        design: ToneDesign,
        instrument: &Instrument,
        options: &SimulateOptions,
    ) -> Option<Self> {
        let Instrument { sweep, sound_speed, .. } = instrument;
        let half = 0.5 * design.time_bandwidth / sweep.bandwidth() * sound_speed;
        let share = if options.losses.vary() { 0.5 } else { 1.0 };
        let loss_nodes = model.chebyshev_nodes(half, share * options.tolerance)?;
        // Tones take one half, nodes the other.
        let tolerance = 0.5 * share * options.tolerance / loss_nodes.lebesgue_constant;
        let tones = EquispacedTones::find(sweep, design, 0.5 * tolerance)?;
        Some(Self { tones, loss_nodes, tolerance })
    }
}

/// Tones of an interval, and tones of a cell in it, which make those of the interval.
#[derive(Debug)]
pub(super) struct TonePair {
    pub(super) tones: EquispacedTones,
    pub(super) local: EquispacedTones,
}

/// By how much the error of a cell's tones is below that of both together, tried in turn: tones of an interval amplify it.
const SHARES: [f64; 4] = [0.5, 0.1, 0.02, 0.004];

/// Delays and frequencies at which the error is measured.
const LOCAL_DELAYS: usize = 9;
const DELAYS: usize = 7;
const FREQUENCIES: usize = 41;

impl TonePair {
    /// Tones of cells for tones of intervals, to within `tolerance` together; `None` if there are none.
    pub(super) fn find(
        tones: &EquispacedTones,
        sweep: &Sweep,
        design: ToneDesign,
        tolerance: f64,
    ) -> Option<Self> {
        let frequencies = tones.frequencies();
        SHARES.iter().find_map(|share| {
            let local = EquispacedTones::about(tones.centre, &frequencies, design, share * tolerance)?;
            let pair = Self { tones: tones.clone(), local };
            // A cell takes no more than half of an interval, so that the rest is left for its place in it.
            let fits = 2.0 * pair.local.duration <= tones.duration;
            (fits && pair.error(sweep) <= tolerance).then_some(pair)
        })
    }

    /// The maximum error of an echo in a cell anywhere in an interval.
    fn error(&self, sweep: &Sweep) -> f64 {
        let Self { tones, local } = self;
        let even = |i: usize, n: usize| i as f64 / (n - 1) as f64 - 0.5;
        let own = |delay: f64| -> Vec<Complex64> {
            let offsets = local.frequencies().into_iter().map(|f| f - local.centre);
            let waves: Vec<Complex64> = offsets.map(|f| phasor_f64(f * delay)).collect();
            let sums = local.weights.chunks_exact(local.count());
            sums.map(|weights| waves.iter().zip(weights).map(|(z, w)| z * f64::from(*w)).sum()).collect()
        };
        let offsets: Vec<f64> = tones.frequencies().into_iter().map(|f| f - tones.centre).collect();
        let last = sweep.len() - 1;
        let chosen: Vec<usize> = (0..FREQUENCIES).map(|i| i * last / (FREQUENCIES - 1)).collect();
        let mut worst = 0.0;
        for i in 0..LOCAL_DELAYS {
            let delay = local.duration * even(i, LOCAL_DELAYS);
            let within = own(delay);
            for k in 0..DELAYS {
                let centre = (tones.duration - local.duration) * even(k, DELAYS);
                let turned = within.iter().zip(&offsets).map(|(z, f)| z * phasor_f64(f * centre));
                let turned: Vec<Complex64> = turned.collect();
                for &n in &chosen {
                    let weights = &tones.weights[n * tones.count()..][..tones.count()];
                    let sum: Complex64 = turned.iter().zip(weights).map(|(z, w)| z * f64::from(*w)).sum();
                    let exact = phasor_f64((sweep.frequencies()[n] - tones.centre) * (delay + centre));
                    worst = greater((sum - exact).norm(), worst);
                }
            }
        }
        worst
    }
}
