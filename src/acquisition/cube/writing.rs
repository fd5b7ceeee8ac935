//! Writes a cube: one list of arrays, as an npz or as a Zarr store.

use super::{CubeView, FORMAT, VERSION};
use crate::acquisition::{Detection, Instrument};
use crate::error::{Error, Result};
use crate::files::npz::write_npz;
use crate::files::zarr::{ArraySpec, MARK, META, ZarrWriter, write_group, write_small};
use crate::files::{AtomicStore, is_store};
use crate::wave::Geometry;
use glam::DVec3;
use num_complex::Complex32;
use serde_json::{Value, json};
use std::io;
use std::path::Path;

/// An array of numbers beside the samples.
struct NamedNumbers {
    name: &'static str,
    dimensions: Vec<&'static str>,
    shape: Vec<usize>,
    data: Vec<f64>,
}

impl CubeView<'_> {
    /// Writes the cube with its origin, as [`DataCube::write`](super::DataCube::write).
    ///
    /// # Errors
    /// As [`DataCube::write`](super::DataCube::write).
    pub fn write(&self, path: &Path, provenance: &Value) -> Result<()> {
        let (meta, others) = (self.meta(provenance), self.positions());
        if is_store(path) {
            self.write_zarr(path, &meta, &others)
        } else {
            self.write_npz(path, &meta, &others)
        }
    }

    fn write_npz(&self, path: &Path, meta: &Value, others: &[NamedNumbers]) -> Result<()> {
        let shape = self.shape().1;
        write_npz(path, |npz| {
            match self.instrument.detection {
                Detection::Quadrature => npz.complex("samples", &shape, self.samples)?,
                Detection::InPhase => npz.f32("samples", &shape, &self.real())?,
            }
            for NamedNumbers { name, shape, data, .. } in others {
                npz.f64(name, shape, data)?;
            }
            npz.text("meta", &meta.to_string())
        })
    }

    fn write_zarr(&self, path: &Path, meta: &Value, others: &[NamedNumbers]) -> Result<()> {
        let store = AtomicStore::create(path)?;
        let write = || -> io::Result<()> {
            let folder = store.folder();
            write_group(folder, &json!({ MARK: { "store": "cube", "version": VERSION }, META: meta }))?;
            let (dimensions, shape) = self.shape();
            // xarray makes coordinates of what is named like this; those that are named like an axis are found anyway.
            let placed: Vec<_> =
                others.iter().map(|other| other.name).filter(|name| *name != "frequencies").collect();
            let attributes = json!({ "coordinates": placed.join(" ") });
            let spec = ArraySpec { dimensions: &dimensions, attributes, zip: true };
            let folder_of = |name: &str| folder.join(name);
            if self.instrument.detection == Detection::Quadrature {
                let mut samples = ZarrWriter::create::<Complex32>(&folder_of("samples"), &shape, &spec)?;
                samples.append(self.samples)?;
                samples.finish();
            } else {
                let mut samples = ZarrWriter::create::<f32>(&folder_of("samples"), &shape, &spec)?;
                samples.append(&self.real())?;
                samples.finish();
            }
            for NamedNumbers { name, dimensions, shape, data } in others {
                let attributes = json!({ "units": if *name == "frequencies" { "Hz" } else { "m" } });
                write_small(
                    &folder_of(name),
                    shape,
                    data,
                    &ArraySpec { dimensions, attributes, zip: false },
                )?;
            }
            Ok(())
        };
        write().map_err(|error| Error::writing(path, error))?;
        store.commit()
    }

    /// The axes of the samples, and how long they are.
    fn shape(&self) -> (Vec<&'static str>, Vec<usize>) {
        let Instrument { sweep, array, .. } = self.instrument;
        let several = Some(self.instrument.transmissions()).filter(|count| *count > 1);
        let dimensions =
            several.map(|_| "tx").into_iter().chain(["frequencies"]).chain(self.of_microphones());
        let shape = several.into_iter().chain([sweep.len()]).chain(array.shape());
        (dimensions.collect(), shape.collect())
    }

    /// The axes of the microphones.
    fn of_microphones(&self) -> Vec<&'static str> {
        if self.instrument.array.shape().len() == 2 { vec!["y", "x"] } else { vec!["mic"] }
    }

    /// The real parts of the samples.
    fn real(&self) -> Vec<f32> {
        self.samples.iter().map(|m| m.re).collect()
    }

    /// The instrument in numbers.
    fn positions(&self) -> Vec<NamedNumbers> {
        let Instrument { sweep, array, geometry, .. } = self.instrument;
        let sources = self.instrument.sources();
        let shape = [array.shape(), vec![3]].concat();
        let dimensions = [self.of_microphones(), vec!["xyz"]].concat();
        let mut all = vec![
            NamedNumbers {
                name: "frequencies",
                dimensions: vec!["frequencies"],
                shape: vec![sweep.len()],
                data: sweep.frequencies().to_vec(),
            },
            NamedNumbers {
                name: "mic_positions",
                dimensions: dimensions.clone(),
                shape: shape.clone(),
                data: array.positions().iter().flat_map(DVec3::to_array).collect(),
            },
        ];
        if sources.len() > 1 {
            let data = sources.iter().flat_map(DVec3::to_array).collect();
            let (dimensions, shape) = (vec!["tx", "xyz"], vec![sources.len(), 3]);
            all.push(NamedNumbers { name: "sources", dimensions, shape, data });
        }
        if let Geometry::Pair { .. } = geometry {
            let pairs = array.positions().iter().enumerate();
            let data =
                pairs.flat_map(|(i, r)| self.instrument.geometry_of(i).source_of(*r).to_array()).collect();
            all.push(NamedNumbers { name: "source_positions", dimensions, shape, data });
        }
        all
    }

    /// The metadata.
    fn meta(&self, provenance: &Value) -> Value {
        let Instrument { geometry, detection, sound_speed, interface, .. } = self.instrument;
        let sources = self.instrument.sources();
        let mut meta = json!({
            "format": FORMAT,
            "version": VERSION,
            "sound_speed": sound_speed,
            "geometry": geometry.kind(),
            "detection": detection,
            "phase_sign": 1,
        });
        if let Some(interface) = interface {
            meta["interface"] = json!(interface);
        }
        if sources.len() <= 1 {
            meta["source"] = json!(sources.first().copied().unwrap_or_default().to_array());
        }
        if !provenance.is_null() {
            meta["provenance"] = provenance.clone();
        }
        meta
    }
}
