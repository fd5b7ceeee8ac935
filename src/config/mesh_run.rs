//! The run file of a mesh that has none: what `init --mesh` writes, and what a bare mesh is imaged with.

use super::{ArrayLayout, RunFile, SceneTable};
use crate::grid::Grid;
use crate::scene::{MeshFrame, Up, metres};
use crate::text::one_line;
use glam::DVec3;
use std::fmt::Write;

/// What suits a mesh; every number becomes a key of the run file.
#[derive(Debug, Clone)]
pub(crate) struct MeshRun {
    /// What was typed of `[scene]`.
    pub scene: SceneTable,
    /// What the mesh's file says.
    pub frame: Option<MeshFrame>,
    /// Sides of the bounding box in front of the array, m.
    pub size: DVec3,
    /// Place of its centre, m; `None` where the scene places it otherwise.
    pub fit: Option<DVec3>,
    /// Microphones along each side, and their pitch, m; `None` for those of a file.
    pub array: Option<(u32, f64)>,
    /// First and last frequency and their step, Hz.
    pub sweep: [f64; 3],
    /// Distance between reflectors, m, where it is larger than usual.
    pub spacing: Option<f64>,
    /// The voxels, once they are known; of their ends and pitches, those that were not typed.
    pub grid: Option<Grid>,
    /// Which of x, y, z and pitch were typed.
    pub typed_grid: [bool; 4],
}

impl MeshRun {
    /// What is known of a mesh before it is read: what was typed.
    pub(crate) fn new(typed: &RunFile, array: (u32, f64)) -> Self {
        let (sweep, grid) = (&typed.sweep, &typed.grid);
        Self {
            scene: typed.scene.clone(),
            frame: None,
            size: DVec3::ZERO,
            fit: typed.scene.fit.map(DVec3::from_array),
            array: (typed.array.layout != ArrayLayout::File).then_some(array),
            sweep: [sweep.start, sweep.stop, sweep.step],
            spacing: None,
            grid: None,
            typed_grid: [
                grid.x.is_some(),
                grid.y.is_some(),
                grid.z.is_some(),
                grid.pitch.is_some() || grid.count.is_some(),
            ],
        }
    }

    /// The run file's text, which names the mesh so.
    pub(crate) fn to_toml(&self, mesh: &str) -> String {
        let mut text = String::new();
        self.write(mesh, &mut text).map(|()| text).unwrap_or_default()
    }

    fn write(&self, mesh: &str, out: &mut String) -> std::fmt::Result {
        writeln!(
            out,
            "# {} before an array that suits its size, as `holosonar image` places a mesh without a run file. Lengths are in m.\n\
             # All other keys and what they mean: `holosonar help run-file`.\n",
            one_line(mesh)
        )?;
        writeln!(out, "[scene]\nmesh = {}", toml::Value::from(mesh))?;
        self.write_placement(out)?;
        let [start, stop, step] = self.sweep;
        writeln!(out, "\n[sweep] # the band sets the resolution in depth, the step how deep a scene may be")?;
        writeln!(out, "start = {start:?}\nstop = {stop:?}\nstep = {step:?}")?;
        if let Some((count, pitch)) = self.array {
            writeln!(out, "\n[array] # 1.8 diagonals of the object wide, from 0.8 to 2 m")?;
            writeln!(out, "count = [{count}, {count}]\npitch = [{pitch:?}, {pitch:?}]")?;
        }
        if let Some(spacing) = self.spacing {
            writeln!(out, "\n[reflectors]")?;
            writeln!(out, "spacing = {spacing:?} # wider than usual, for fewer of them")?;
        }
        self.grid.map_or(Ok(()), |grid| self.write_grid(out, &grid))
    }

    fn write_placement(&self, out: &mut String) -> std::fmt::Result {
        let SceneTable { unit, size, scale, rotate, sensor, .. } = &self.scene;
        let lengths = self.size.to_array().map(metres).join(" x ");
        if let Some(unit) = unit {
            writeln!(out, "unit = \"{unit}\" # of the file's coordinates; placed, the object is {lengths}")?;
        } else if let Some(size) = size {
            writeln!(out, "size = {size:?} # the longest side; placed, the object is {lengths}")?;
        } else {
            writeln!(out, "# The object is {lengths}.")?;
        }
        if let Some(up) = self.frame.and_then(|frame| frame.up) {
            let others: Vec<String> =
                Up::ALL.iter().filter(|other| **other != up).map(|other| format!("\"{other}\"")).collect();
            writeln!(out, "up = \"{up}\" # the file's upward axis; or {}", others.join(" or "))?;
        }
        if *scale != 1.0 {
            writeln!(out, "scale = {scale:?}")?;
        }
        writeln!(
            out,
            "rotate = {rotate:?} # degrees about x (right), then y (down), then z (away from the array)"
        )?;
        if let Some(sensor) = sensor {
            writeln!(out, "sensor = {}", toml::Value::from(sensor.as_str()))?;
        }
        match (self.fit, self.scene.translate) {
            (Some(fit), _) => writeln!(out, "fit = {:?} # the centre of the object", fit.to_array()),
            (None, Some(translate)) => writeln!(out, "translate = {translate:?}"),
            (None, None) => Ok(()),
        }
    }

    fn write_grid(&self, out: &mut String, grid: &Grid) -> std::fmt::Result {
        if self.typed_grid == [true; 4] {
            return Ok(());
        }
        writeln!(out, "\n[grid] # the voxels: first and last, and their pitch")?;
        let axes = [("x", grid.x), ("y", grid.y), ("z", grid.z)];
        for ((name, axis), typed) in axes.iter().zip(self.typed_grid) {
            if !typed {
                // The last voxel is the last within the end, so that an end may be rounded.
                let last = (axis.last() * 1e6).ceil() / 1e6;
                writeln!(out, "{name} = [{:?}, {last:?}]", axis.first)?;
            }
        }
        if !self.typed_grid[3] {
            writeln!(out, "pitch = {:?}", axes.map(|(_, axis)| axis.pitch))?;
        }
        Ok(())
    }
}
