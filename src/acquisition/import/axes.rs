//! Which axis of an array is what, and the order of its elements in a cube.

use super::Positions;
use crate::choice::choice;
use std::fmt::Write;

choice! {
    /// What an axis of an array is.
    pub enum ImportAxis: "axis" {
        /// Loudspeakers, one after another.
        Transmission = "tx",
        /// Frequencies.
        Frequency = "f",
        /// Columns of microphones.
        X = "x",
        /// Rows of microphones.
        Y = "y",
        /// All microphones, row by row.
        Microphone = "mic",
        /// Pairs of a microphone and a loudspeaker of its own.
        Pair = "pair",
        /// Of length 2: I, then Q.
        Plane = "iq",
        /// Of length 1: nothing.
        Single = "-",
    }
}

/// Axes that make a cube, in any order and with or without [`ImportAxis::Plane`]; of several loudspeakers with
/// [`ImportAxis::Transmission`].
const SETS: [&[ImportAxis]; 5] = [
    &[ImportAxis::Frequency, ImportAxis::Y, ImportAxis::X],
    &[ImportAxis::Frequency, ImportAxis::Microphone],
    &[ImportAxis::Y, ImportAxis::X],
    &[ImportAxis::Microphone],
    &[ImportAxis::Frequency],
];

/// Where the elements of a cube are in an array in C order.
#[derive(Debug, PartialEq)]
pub(super) struct SampleOrder {
    pub(super) axes: Vec<ImportAxis>,
    strides: Vec<usize>,
    /// Rows and columns of microphones; of a list of them one row.
    rows: [usize; 2],
    /// Transmissions and frequencies.
    counts: [usize; 2],
    /// Whether the array has axes x or y, rather than a list of microphones.
    in_rows: bool,
}

impl SampleOrder {
    /// The layout of an array of this shape for so many transmissions and frequencies, and these microphones.
    ///
    /// # Errors
    /// Axes that do not suit the shape, or the shape the measurement; without axes, several or none that do.
    pub(super) fn new(
        typed: &[ImportAxis],
        shape: &[usize],
        counts: [usize; 2],
        positions: &Positions,
        may_have_planes: bool,
    ) -> Result<Self, String> {
        if !typed.is_empty() {
            return Self::of(typed, shape, counts, positions);
        }
        let [n_tx, n_f] = counts;
        // A cube of one loudspeaker has four axes at most; single ones come on top.
        let most = if n_tx > 1 { 5 } else { 4 };
        let open: Vec<usize> = if shape.len() > most { Vec::new() } else { (0..shape.len()).collect() };
        let mut found: Vec<Self> = Vec::new();
        let mut orders = Vec::new();
        permute(&open, &mut Vec::new(), &mut orders);
        for set in SETS {
            for plane in [false, true] {
                let mut labels = set.to_vec();
                labels.extend((n_tx > 1).then_some(ImportAxis::Transmission));
                labels.extend((plane && may_have_planes).then_some(ImportAxis::Plane));
                labels.resize(labels.len().max(shape.len()), ImportAxis::Single);
                for order in orders.iter().filter(|order| order.len() == labels.len()) {
                    let axes: Vec<ImportAxis> = order.iter().map(|i| labels[*i]).collect();
                    if let Ok(layout) = Self::of(&axes, shape, counts, positions)
                        && !found.iter().any(|other| other.places() == layout.places())
                    {
                        found.push(layout);
                    }
                }
            }
        }
        let of_sources = if n_tx > 1 { format!("{n_tx} loudspeakers, ") } else { String::new() };
        let known = format!("{of_sources}{n_f} frequencies and {}", positions.described());
        match found.len() {
            1 => Ok(found.remove(0)),
            0 => Err(format!(
                "has the shape {shape:?}, whose axes cannot be {known}; say in [import] what they are, as in axes = [\"x\", \
                 \"y\", \"f\"], or correct [sweep] or [array]"
            )),
            _ => {
                let mut problem = format!(
                    "has the shape {shape:?}, in which {known} can be found in {} ways; say in [import] which is right:",
                    found.len()
                );
                for layout in found.iter().take(3) {
                    let _ = write!(problem, " axes = {},", words(&layout.axes));
                }
                Err(format!("{} ...", problem.trim_end_matches(',')))
            }
        }
    }

    /// The layout for these axes.
    fn of(
        axes: &[ImportAxis],
        shape: &[usize],
        counts: [usize; 2],
        positions: &Positions,
    ) -> Result<Self, String> {
        let [n_tx, n_f] = counts;
        let all = words(axes);
        // Each pair has a microphone.
        let microphone =
            |axis: &ImportAxis| if *axis == ImportAxis::Pair { ImportAxis::Microphone } else { *axis };
        let axes: &[ImportAxis] = &axes.iter().map(microphone).collect::<Vec<_>>();
        if axes.len() != shape.len() {
            return Err(format!("has the shape {shape:?}, and axes = {all} names {} axes", axes.len()));
        }
        let length = |axis| axes.iter().position(|other| *other == axis).map(|i| shape[i]);
        let twice =
            axes.iter().enumerate().find(|(i, a)| **a != ImportAxis::Single && axes[..*i].contains(a));
        if let Some((_, axis)) = twice {
            return Err(format!("cannot have the axis \"{axis}\" twice, as in axes = {all}"));
        }
        for (axis, expected) in [
            (ImportAxis::Plane, 2),
            (ImportAxis::Single, 1),
            (ImportAxis::Frequency, n_f),
            (ImportAxis::Transmission, n_tx),
        ] {
            let mut wrong = axes.iter().zip(shape).filter(|(a, n)| **a == axis && **n != expected);
            if let Some((_, n)) = wrong.next() {
                return Err(format!(
                    "has the shape {shape:?}: its axis \"{axis}\" of axes = {all} is {n} long, and {expected} was expected"
                ));
            }
        }
        if n_f != 1 && length(ImportAxis::Frequency).is_none() {
            return Err(format!("has no axis \"f\" in axes = {all}, and there are {n_f} frequencies"));
        }
        if n_tx != 1 && length(ImportAxis::Transmission).is_none() {
            return Err(format!(
                "has no axis \"tx\" in axes = {all}, and there are {n_tx} loudspeakers; name it, or give as many files for each \
                 of them, in their order"
            ));
        }
        let (x, y) = (length(ImportAxis::X), length(ImportAxis::Y));
        let mic = length(ImportAxis::Microphone);
        let in_rows = x.is_some() || y.is_some();
        if in_rows && mic.is_some() {
            return Err(format!("has both \"mic\" and \"x\" or \"y\" in axes = {all}; name one of them"));
        }
        let rows = if in_rows { [y.unwrap_or(1), x.unwrap_or(1)] } else { [1, mic.unwrap_or(1)] };
        let count = rows[0].saturating_mul(rows[1]);
        let fits =
            count == positions.array.len() && (!in_rows || positions.rows.is_none_or(|known| known == rows));
        if !fits {
            let [n_y, n_x] = rows;
            let found = if in_rows { format!("{n_x} x {n_y}") } else { count.to_string() };
            return Err(format!(
                "has the shape {shape:?}: with axes = {all} there are {found} microphones, and {} were expected",
                positions.described()
            ));
        }
        let mut strides = vec![1_usize; shape.len()];
        for i in (1..shape.len()).rev() {
            strides[i - 1] = strides[i].saturating_mul(shape[i]);
        }
        Ok(Self { axes: axes.to_vec(), strides, rows, counts, in_rows })
    }

    /// What decides where every sample is, however axes of length 1 are called.
    fn places(&self) -> ([usize; 4], [usize; 2], Option<usize>) {
        let x = if self.in_rows { ImportAxis::X } else { ImportAxis::Microphone };
        let [n_tx, n_f] = self.counts;
        let axes = [
            (ImportAxis::Transmission, n_tx),
            (ImportAxis::Frequency, n_f),
            (ImportAxis::Y, self.rows[0]),
            (x, self.rows[1]),
        ];
        let strides = axes.map(|(axis, n)| if n == 1 { 0 } else { self.stride(axis) });
        (strides, self.rows, self.to_q())
    }

    fn stride(&self, axis: ImportAxis) -> usize {
        self.axes.iter().position(|other| *other == axis).map_or(0, |i| self.strides[i])
    }

    /// Distance from an I to its Q; `None` if they are not in one array.
    pub(super) fn to_q(&self) -> Option<usize> {
        self.axes.contains(&ImportAxis::Plane).then(|| self.stride(ImportAxis::Plane))
    }

    /// Passes the place of every sample, `[n_tx, n_f, n_mic]`, to `take`.
    pub(super) fn visit(&self, mut take: impl FnMut(usize)) {
        let along_x = if self.in_rows { ImportAxis::X } else { ImportAxis::Microphone };
        let (tx_stride, f_stride) =
            (self.stride(ImportAxis::Transmission), self.stride(ImportAxis::Frequency));
        let (x_stride, y_stride) = (self.stride(along_x), self.stride(ImportAxis::Y));
        let [n_tx, n_f] = self.counts;
        for tone in (0..n_tx).flat_map(|tx| (0..n_f).map(move |f| tx * tx_stride + f * f_stride)) {
            for y in 0..self.rows[0] {
                let row = tone + y * y_stride;
                (0..self.rows[1]).for_each(|x| take(row + x * x_stride));
            }
        }
    }
}

/// Axes as they are typed.
pub(super) fn words(axes: &[ImportAxis]) -> String {
    format!("{:?}", axes.iter().map(|axis| axis.as_str()).collect::<Vec<_>>())
}

/// All orders of what is left.
fn permute(left: &[usize], begun: &mut Vec<usize>, all: &mut Vec<Vec<usize>>) {
    if left.is_empty() {
        all.push(begun.clone());
    }
    for (i, next) in left.iter().enumerate() {
        begun.push(*next);
        permute(&[&left[..i], &left[i + 1..]].concat(), begun, all);
        begun.pop();
    }
}
