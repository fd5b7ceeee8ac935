//! What moves while the tones are played, and what cannot be simulated or compensated then.

use crate::acquisition::QuadratureBy;
use crate::config::RunFile;
use crate::config::choices::RefineMethod;
use crate::config::range::{Check, conflict, ensure, within};
use crate::config::reader::Fault;
use crate::reconstruct::Method;
use crate::wave::FASTEST;

impl RunFile {
    pub(super) fn check_motion(&self) -> Check {
        let of_part = |(index, part): (usize, &crate::config::ScenePart)| {
            Some((format!("scene.parts[{index}].velocity"), part.velocity?))
        };
        let of_scene = self.scene.velocity.map(|velocity| ("scene.velocity".to_owned(), velocity));
        let of_frame = self.medium.velocity.map(|velocity| ("medium.velocity".to_owned(), velocity));
        let all = of_scene.into_iter().chain(self.scene.parts.iter().enumerate().filter_map(of_part));
        let moving: Vec<_> = all.collect();
        for (key, velocity) in moving.iter().chain(&of_frame) {
            for along in velocity {
                within(
                    key,
                    *along,
                    -FASTEST,
                    FASTEST,
                    "m/s along x, y and z, up to 1e4, as [0.0, 0.0, 0.1]",
                )?;
            }
            ensure(self.recording.dwell.is_some(), || {
                let problem =
                    "needs to know how long each tone is played: give `dwell` in [recording], in s, as 0.05";
                Fault::new(key.as_str(), problem)
            })?;
        }
        if let Some((key, _)) = moving.first() {
            let apart = self.scene.parts.iter().any(|part| part.velocity.is_some());
            let partners: [(bool, &'static [&'static str]); 2] =
                [(self.scene.bounces > 0, &["scene.bounces"]), (self.scene.edges, &["scene.edges"])];
            for (found, partner) in partners {
                ensure(!(found && apart), || {
                    let why = format!(
                        "{} between surfaces that move apart change in ways of their own; let all move alike, by scene.velocity",
                        partner[0]
                    );
                    conflict(key, partner, &why)
                })?;
            }
            ensure(self.instrument.quadrature != QuadratureBy::Passes, || {
                let why = "instrument.quadrature = \"passes\" plays the sweep twice, and what moves is simulated once";
                conflict(key, &["instrument.quadrature"], why)
            })?;
        }
        if of_frame.is_none() {
            return Ok(());
        }
        let refused: [(bool, &'static [&'static str], &str); 3] = [
            (
                self.refine.method != RefineMethod::None,
                &["refine.method"],
                "a frame that moves has no refine.method",
            ),
            (
                self.reconstruct.method == Method::Correlation,
                &["reconstruct.method"],
                "\"correlation\" is not compensated for motion, and forgives its phases as well",
            ),
            (
                self.medium.interface.is_some(),
                &["medium.interface"],
                "an interface would move with the frame",
            ),
        ];
        let found = refused.into_iter().find(|(found, _, _)| *found);
        found.map_or(Ok(()), |(_, partners, why)| Err(conflict("medium.velocity", partners, why)))
    }
}
