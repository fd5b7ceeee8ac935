//! What interpolation of a line's image errs by, measured on single terms.

use super::extent::spread;
use super::nodes::{BlockNodes, Ruler};
use super::view::LineView;
use crate::acquisition::Instrument;
use crate::grid::Axis;
use crate::reconstruct::numerics::Taps;
use crate::wave::interval::{greater, phasor_f64};
use crate::wave::simd::LANES;
use num_complex::Complex64;
use rayon::prelude::*;

/// Blocks, lines, rows and depths that are tried.
const TRIED: [usize; 4] = [4, 3, 4, 4];

/// Between these places errors are a little larger.
const BETWEEN: f64 = 1.3;

/// The terms that a job can have: one frequency and one microphone each.
pub(crate) struct Trial<'a> {
    view: &'a LineView,
    /// The middle of the band and its ends, cycles per m.
    carrier: f64,
    ends: [f64; 2],
}

/// Nodes around a place along one coordinate, m, and their weights.
fn around(ruler: &Ruler, taps: Option<&Taps>, place: f64) -> (Vec<f64>, Vec<f64>) {
    let Some(taps) = taps else { return (vec![place], vec![1.0]) };
    let pitches = (place - ruler.origin()) / ruler.pitch;
    // The first place may be rounded to before its nodes.
    let own = pitches.floor().max(0.0);
    let nodes = (0..taps.count()).map(|k| ruler.position(own as usize + k)).collect();
    (nodes, taps.weights(pitches - own))
}

/// The larger error, and the larger sum of moduli.
fn greatest([error, moduli]: [f64; 2], [other, more]: [f64; 2]) -> [f64; 2] {
    [greater(error, other), moduli.max(more)]
}

impl<'a> Trial<'a> {
    pub(crate) fn new(instrument: &Instrument, view: &'a LineView) -> Self {
        let sweep = &instrument.sweep;
        let [carrier, low, high] =
            [sweep.centre(), sweep.start(), sweep.stop()].map(|f| f / instrument.sound_speed);
        Self { view, carrier, ends: [low, high] }
    }

    /// The largest error of any term that is tried, and the largest sum of the weights' moduli.
    pub(crate) fn error(&self, blocks: &[BlockNodes], taps: [Option<&Taps>; 2]) -> [f64; 2] {
        let view = self.view;
        let of_block = |i: usize| {
            let block = &blocks[i];
            let nearest = |axis: &Axis, place: f64| place.clamp(axis.first, axis.last());
            let mut lines: Vec<f64> =
                spread(view.lines.count, TRIED[1]).map(|i| view.lines.position(i)).collect();
            let mut rows: Vec<f64> =
                spread(view.rows.count, TRIED[2]).map(|i| view.rows.position(i)).collect();
            // Terms bend most near a line and near the loudspeaker.
            if let Some([_, y, _]) = view.source {
                rows.push(nearest(&view.rows, y));
            }
            lines.push(nearest(&view.lines, view.rows.position(view.rows.count / 2)));
            let mut most = [0.0, 1.0f64];
            for line in lines {
                for row in rows.iter().copied().chain([nearest(&view.rows, line)]) {
                    for depth in spread(view.depths.count, TRIED[3]) {
                        let place = [line, row, view.depths.position(depth)];
                        most = greatest(most, self.error_at(block, taps, place));
                    }
                }
            }
            most
        };
        let tried: Vec<usize> = spread(blocks.len(), TRIED[0]).collect();
        let of_blocks: Vec<[f64; 2]> = tried.into_par_iter().with_max_len(1).map(of_block).collect();
        let [worst, growth] = of_blocks.into_iter().fold([0.0, 1.0], greatest);
        [BETWEEN * worst, growth]
    }

    /// At one place of a line, row and depth.
    fn error_at(
        &self,
        block: &BlockNodes,
        taps: [Option<&Taps>; 2],
        [line, row, depth]: [f64; 3],
    ) -> [f64; 2] {
        let (view, legs) = (self.view, self.view.legs);
        let rho = view.rho(line, row, depth);
        let over_source = view.over_source(row, depth);
        let path = (over_source + block.to_source(view)).sqrt() + block.back(rho);
        let (rhos, along_rho) = around(&block.rho, taps[0], rho);
        let (paths, along_path) = around(&block.path, taps[1], path);
        let moduli = |weights: &[f64]| weights.iter().map(|w| w.abs()).sum::<f64>();
        let lanes = block.lanes(&view.columns);
        // Outward lengths of the nodes, and of the place itself.
        let outward: Vec<Vec<[f64; LANES]>> = rhos
            .iter()
            .map(|rho| paths.iter().map(|path| block.outward(view, *rho, *path)).collect())
            .collect();
        let own = block.outward(view, rho, path);
        let mut worst = 0.0;
        for lane in [0, block.columns.len() - 1] {
            let microphones = spread(view.microphones.count, 3).map(|a| view.microphones.position(a));
            // Those whose pair is nearest, by its microphone, its middle and its loudspeaker.
            let ends = if view.apart == 0.0 { 1 } else { 3 };
            let nearest = [0.0, 0.5, 1.0].into_iter().take(ends).map(|share| {
                let own = lanes[lane] - share * view.apart;
                own.clamp(view.microphones.first, view.microphones.last())
            });
            let asides: Vec<f64> = microphones.chain(nearest).map(|x| x - lanes[lane]).collect();
            for f in self.ends {
                let turned = |outward: &[f64; LANES]| phasor_f64((f - self.carrier) * outward[lane]);
                let around: Vec<Complex64> = outward
                    .iter()
                    .map(|nodes| nodes.iter().zip(&along_path).map(|(node, w)| turned(node) * w).sum())
                    .collect();
                for aside in &asides {
                    let back = |rho: f64| {
                        phasor_f64(legs * (f * view.leg(rho, *aside) - self.carrier * block.back(rho)))
                    };
                    let nodes = rhos.iter().zip(&along_rho).zip(&around);
                    let sum: Complex64 = nodes.map(|((rho, w), paths)| back(*rho) * paths * w).sum();
                    let exact = back(rho) * turned(&own);
                    worst = greater(worst, (sum - exact).norm());
                }
            }
        }
        [worst, moduli(&along_rho) * moduli(&along_path)]
    }
}
