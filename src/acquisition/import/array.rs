//! NumPy files as samples: their arrays by name or number, as complex numbers or as planes of I and Q.

use super::axes::SampleOrder;
use super::{ImportOptions, place_of_key};
use crate::alloc::try_with_capacity;
use crate::error::{Error, Result};
use crate::files::extension;
use crate::files::npz::{Array, NpyReader, NpzReader};
use crate::text::quoted;
use num_complex::{Complex32, Complex64};
use serde::{Deserialize, Serialize};
use std::fmt::{self, Display};
use std::path::{Path, PathBuf};

/// Which array of a file: its name in an `.npz`, or its number, counted from 0 over all `.npy` files.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected the name of an array, or its number counted from 0")]
pub enum ArrayName {
    /// The number.
    Number(u32),
    /// The name.
    Name(String),
}

impl Display for ArrayName {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Number(number) => write!(f, "{number}"),
            Self::Name(name) => write!(f, "`{}`", quoted(name)),
        }
    }
}

/// What is subtracted from raw numbers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected a number, [I, Q], or \"mean\"")]
pub enum RawOffset {
    /// The same of I and Q.
    Both(f64),
    /// Of I, and of Q.
    Planes([f64; 2]),
    /// The mean of all numbers of a plane.
    Mean(MeanWord),
}

/// The word for the mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum MeanWord {
    /// Of a plane, over all frequencies and positions.
    #[serde(rename = "mean")]
    Mean,
}

/// An open NumPy file.
enum NumpyFile {
    Npy(NpyReader),
    Npz(NpzReader),
}

/// An array of an open file: which file, and its name or number there.
struct FoundArray {
    file: usize,
    index: usize,
    name: String,
    place: String,
    shape: Vec<usize>,
    complex: bool,
    unsigned: bool,
}

/// Numbers of one array, or of two.
enum Planes {
    Complex(Vec<Complex32>),
    Real(Vec<f64>),
    Pair(Vec<f64>, Vec<f64>),
}

/// The arrays that hold the samples, as they are in the files.
pub(super) struct RawSamples {
    planes: Planes,
    pub(super) shape: Vec<usize>,
    pub(super) names: Vec<String>,
    pub(super) place: String,
}

/// The NumPy files of an import.
pub(super) struct NumpyFiles {
    files: Vec<NumpyFile>,
    candidates: Vec<FoundArray>,
}

impl NumpyFiles {
    /// Opens the files and lists their arrays.
    pub(super) fn open(paths: &[PathBuf], limit: u64) -> Result<Self> {
        let (mut files, mut candidates) = (Vec::new(), Vec::new());
        for (file, path) in paths.iter().enumerate() {
            if extension(path) == "npz" {
                let npz = NpzReader::open(path, limit)?;
                for name in npz.names() {
                    // An array that cannot be read, such as one of objects, is a fault only when it is asked for.
                    let Ok(shape) = npz.shape(name) else { continue };
                    candidates.push(FoundArray {
                        file,
                        index: 0,
                        name: name.to_owned(),
                        place: format!("{}, array `{}`", path.display(), quoted(name)),
                        shape,
                        complex: npz.dtype_is_complex(name)?,
                        unsigned: npz.dtype_is_unsigned(name)?,
                    });
                }
                files.push(NumpyFile::Npz(npz));
            } else {
                let npy = NpyReader::open(path, limit)?;
                let before = candidates.len();
                candidates.extend((0..npy.len()).map(|index| FoundArray {
                    file,
                    index,
                    name: (before + index).to_string(),
                    place: format!("{}, array {index}", path.display()),
                    shape: npy.shape(index).to_vec(),
                    complex: npy.dtype_is_complex(index),
                    unsigned: npy.dtype_is_unsigned(index),
                }));
                files.push(NumpyFile::Npy(npy));
            }
        }
        Ok(Self { files, candidates })
    }

    /// An array of real numbers by its name, in an `.npz`.
    pub(super) fn named(&mut self, name: &str) -> Option<Result<Array<f64>>> {
        let npz = self.files.iter_mut().find_map(|file| match file {
            NumpyFile::Npz(npz) => Some(npz),
            NumpyFile::Npy(_) => None,
        })?;
        Some(npz.f64(name))
    }

    /// The only array of a file, real numbers.
    pub(super) fn only(&mut self) -> Result<Array<f64>> {
        match &mut self.files[..] {
            [NumpyFile::Npy(npy)] => npy.f64(0),
            _ => Err(Error::input(place_of_key("samples"), "one .npy file was expected")),
        }
    }

    /// The arrays of the samples: those that were named, or else the only ones that there are.
    fn choose(&self, options: &ImportOptions, guesses: &mut Vec<String>) -> Result<Vec<usize>> {
        let all = || {
            let each = |c: &FoundArray| format!("{} {:?}", c.name, c.shape);
            let list: Vec<_> = self.candidates.iter().take(20).map(each).collect();
            if list.is_empty() { "none that can be read".to_owned() } else { list.join(", ") }
        };
        let refuse = |problem: String| Err(Error::input(place_of_key("arrays"), problem));
        if options.arrays.len() > 2 {
            return refuse("names more than two arrays; one was expected, or two for I and Q".into());
        }
        if !options.arrays.is_empty() {
            let chosen = options.arrays.iter().map(|wanted| {
                let wanted_name = match wanted {
                    ArrayName::Number(number) => number.to_string(),
                    ArrayName::Name(name) => name.clone(),
                };
                let found = self.candidates.iter().position(|c| c.name == wanted_name);
                found.ok_or_else(|| {
                    let problem = format!("names the array {wanted}, and the arrays are {}", all());
                    Error::input(place_of_key("arrays"), problem)
                })
            });
            return chosen.collect();
        }
        let used = [&options.frequencies, &options.positions, &options.source_file];
        let is_used = |name: &str| used.iter().any(|used| used.as_deref() == Some(Path::new(name)));
        let free: Vec<usize> =
            (0..self.candidates.len()).filter(|i| !is_used(&self.candidates[*i].name)).collect();
        match free[..] {
            [only] => Ok(vec![only]),
            [i, q] if self.are_planes(i, q) => {
                let [i_name, q_name] = [i, q].map(|i| &self.candidates[i].place);
                guesses.push(format!("planes: {i_name} is I, {q_name} is Q"));
                Ok(vec![i, q])
            }
            _ => refuse(format!(
                "is missing: there are {} arrays ({}); name the one that holds the samples, or two for I and Q",
                free.len(),
                all()
            )),
        }
    }

    fn are_planes(&self, i: usize, q: usize) -> bool {
        let [i, q] = [i, q].map(|i| &self.candidates[i]);
        i.shape == q.shape && !i.complex && !q.complex
    }

    fn f64(&mut self, candidate: usize) -> Result<Vec<f64>> {
        let FoundArray { file, index, name, .. } = &self.candidates[candidate];
        match &mut self.files[*file] {
            NumpyFile::Npy(npy) => npy.f64(*index),
            NumpyFile::Npz(npz) => npz.f64(name),
        }
        .map(|array| array.data)
    }

    /// Reads the arrays of the samples.
    pub(super) fn samples(
        &mut self,
        options: &ImportOptions,
        guesses: &mut Vec<String>,
    ) -> Result<RawSamples> {
        let chosen = self.choose(options, guesses)?;
        let first = &self.candidates[chosen[0]];
        let (shape, place) = (first.shape.clone(), first.place.clone());
        let unsigned = chosen.iter().any(|i| self.candidates[*i].unsigned);
        let names = chosen.iter().map(|i| self.candidates[*i].name.clone()).collect();
        let planes = match chosen[..] {
            [i, q] => {
                if !self.are_planes(i, q) {
                    let other = &self.candidates[q];
                    let problem = format!(
                        "and {} were expected to be I and Q, two real arrays of one shape; their shapes are {shape:?} and {:?}",
                        other.place, other.shape
                    );
                    return Err(Error::input(place, problem));
                }
                Planes::Pair(self.f64(i)?, self.f64(q)?)
            }
            _ if first.complex => {
                let FoundArray { file, index, name, .. } = first;
                let array = match &mut self.files[*file] {
                    NumpyFile::Npy(npy) => npy.complex(*index)?,
                    NumpyFile::Npz(npz) => npz.complex(name)?,
                };
                Planes::Complex(array.data)
            }
            _ => Planes::Real(self.f64(chosen[0])?),
        };
        if unsigned && options.offset.is_none() {
            let problem = "holds unsigned integers, whose zero is somewhere in the middle of their range; give `offset` in \
                           [import]: a number such as 2048 of a 12-bit converter, [I, Q], or \"mean\"";
            return Err(Error::input(place, problem));
        }
        Ok(RawSamples { planes, shape, names, place })
    }
}

impl RawSamples {
    /// Whether one array could hold both I and Q along an axis.
    pub(super) fn may_have_planes(&self) -> bool {
        matches!(self.planes, Planes::Real(_))
    }

    /// Whether the samples have no imaginary parts.
    pub(super) fn is_real(&self, layout: &SampleOrder) -> bool {
        self.may_have_planes() && layout.to_q().is_none()
    }

    /// The numbers of I and of Q.
    fn parts(&self, layout: &SampleOrder, at: usize) -> [f64; 2] {
        match &self.planes {
            Planes::Complex(all) => [all[at].re.into(), all[at].im.into()],
            Planes::Real(all) => [all[at], layout.to_q().map_or(0.0, |q| all[at + q])],
            Planes::Pair(i, q) => [i[at], q[at]],
        }
    }

    /// The samples, `[n_tx, n_f, n_mic]`, and what was subtracted.
    ///
    /// # Errors
    /// Samples that do not fit in memory, axes that contradict the arrays.
    pub(super) fn samples(
        &self,
        layout: &SampleOrder,
        offset: Option<RawOffset>,
    ) -> Result<(Vec<Complex32>, Option<[f64; 2]>)> {
        if layout.to_q().is_some() && !self.may_have_planes() {
            let problem = "is complex, or one of two planes; an axis \"iq\" needs one real array";
            return Err(Error::input(&self.place, problem));
        }
        let means = || {
            let (mut sum, mut count) = ([0.0; 2], 0.0);
            layout.visit(|at| {
                let parts = self.parts(layout, at);
                sum = [sum[0] + parts[0], sum[1] + parts[1]];
                count += 1.0;
            });
            sum.map(|sum| sum / f64::max(count, 1.0))
        };
        let subtracted = offset.map(|offset| match offset {
            RawOffset::Both(both) => [both; 2],
            RawOffset::Planes(planes) => planes,
            RawOffset::Mean(_) => means(),
        });
        let real = self.is_real(layout);
        let [i_zero, q_zero] = subtracted.unwrap_or_default();
        let q_zero = if real { 0.0 } else { q_zero };
        let mut samples =
            try_with_capacity(self.shape.iter().fold(1_u64, |n, size| n.saturating_mul(*size as u64)))
                .ok_or_else(|| {
                    Error::out_of_memory(format!("{} does not fit in memory twice", self.place))
                })?;
        layout.visit(|at| {
            let [i, q] = self.parts(layout, at);
            let value = Complex64::new(i - i_zero, q - q_zero);
            samples.push(Complex32::new(value.re as f32, value.im as f32));
        });
        Ok((samples, subtracted))
    }
}
