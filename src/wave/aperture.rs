//! What decides how sharply a point is imaged: the band, the extent of the array, the way of the sound.

use super::{Geometry, Interface, Refraction};
use glam::DVec3;

/// A band and the extent of an array, without their frequencies and microphones.
///
/// # Example
/// 10 to 20 kHz and an array of a metre resolve 17 mm in depth and, 2 m away, 46 mm across:
/// ```
/// use holosonar::glam::DVec3;
/// use holosonar::wave::{Aperture, Geometry};
///
/// let aperture = Aperture {
///     sound_speed: 343.0,
///     band: [10e3, 20e3],
///     centre: DVec3::ZERO,
///     extent: DVec3::new(1.0, 1.0, 0.0),
///     geometry: Geometry::ORIGIN,
///     interface: None,
/// };
/// assert_eq!(aperture.range_resolution(), Some(343.0 / 20e3));
/// assert!((aperture.lateral_resolution(2.0)[0].unwrap() - 0.0457).abs() < 1e-4);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aperture {
    /// c, m/s.
    pub sound_speed: f64,
    /// Lowest and highest frequency, Hz.
    pub band: [f64; 2],
    /// Centre of the array, m.
    pub centre: DVec3,
    /// First to last microphone along each axis, m.
    pub extent: DVec3,
    /// Fixed speaker or monostatic scan.
    pub geometry: Geometry,
    /// A plane beyond which sound has another speed, if there is one.
    pub interface: Option<Interface>,
}

impl Aperture {
    /// Middle of the band, Hz.
    pub fn centre_frequency(&self) -> f64 {
        f64::midpoint(self.band[0], self.band[1])
    }

    /// B, Hz.
    pub fn bandwidth(&self) -> f64 {
        self.band[1] - self.band[0]
    }

    /// Wavelength in the middle of the band, λ_c, m.
    pub fn wavelength(&self) -> f64 {
        self.sound_speed / self.centre_frequency()
    }

    /// Range resolution Δd = c/2B, m (Eq. 10), with the speed beyond the interface if there is one; `None` for a single
    /// frequency.
    pub fn range_resolution(&self) -> Option<f64> {
        let beyond = self.interface.map_or(self.sound_speed, |interface| interface.sound_speed);
        let cell = beyond / (2.0 * self.bandwidth());
        cell.is_finite().then_some(cell)
    }

    /// Lateral resolution λ_c z/D along x and y at depth `z`, m; `None` along an axis without extent. Never less than half
    /// a wavelength, the finest that waves from all sides resolve.
    ///
    /// Not Eq. 12, whose right side is dimensionless (an angle) and knows no wavelength. A monostatic
    /// scan resolves twice as finely, since both legs change. Beyond an interface z is the depth at which the point appears
    /// to be, as a stone in a pond.
    pub fn lateral_resolution(&self, z: f64) -> [Option<f64>; 2] {
        let wavelength = self.wavelength() / self.geometry.scanned_legs();
        let z = self.interface.map_or(z, |interface| interface.apparent_depth(self.sound_speed, z));
        [self.extent.x, self.extent.y].map(|d| (d > 0.0).then(|| wavelength * (z / d).max(0.5)))
    }

    /// How fast the mean path length over the array grows along +z at `p`: 2 straight ahead and far away, less aside.
    ///
    /// The mean is that of the four nodes of Gauss' rule on the array's rectangle.
    pub(crate) fn path_gradient(&self, p: DVec3) -> f64 {
        let refraction = self.interface.map(|interface| Refraction::new(&interface, self.sound_speed, 0.0));
        let straight = |way: DVec3| way.z / way.length().max(f64::MIN_POSITIVE);
        let along = |from: DVec3| {
            refraction.map_or_else(|| straight(p - from), |refraction| refraction.slope_along_z(from, p))
        };
        let node = self.extent * (0.5 / 3f64.sqrt());
        let signs = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)];
        let back =
            signs.map(|(x, y)| along(self.centre + node * DVec3::new(x, y, 0.0))).iter().sum::<f64>() / 4.0;
        match self.geometry {
            Geometry::FixedSource { source } => along(source) + back,
            Geometry::Monostatic => 2.0 * back,
            Geometry::Pair { offset } => {
                let out = signs.map(|(x, y)| along(self.centre + offset + node * DVec3::new(x, y, 0.0)));
                out.iter().sum::<f64>() / 4.0 + back
            }
        }
    }
}

/// What can be told apart: depths to within Δd and, where the aperture is known, places across.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resolution {
    /// Δd, m.
    pub range: f64,
    /// By which the lateral resolution is known.
    pub aperture: Option<Aperture>,
}

impl Resolution {
    /// Lateral resolution along x and y at depth `z`, m, where it is known.
    pub fn lateral(&self, z: f64) -> [Option<f64>; 2] {
        self.aperture.map_or([None; 2], |aperture| aperture.lateral_resolution(z))
    }
}

/// A range resolution in m, and nothing known across.
impl From<f64> for Resolution {
    fn from(range: f64) -> Self {
        Self { range, aperture: None }
    }
}

/// Both resolutions of an aperture; that of range is NaN for a single frequency.
impl From<Aperture> for Resolution {
    fn from(aperture: Aperture) -> Self {
        Self { range: aperture.range_resolution().unwrap_or(f64::NAN), aperture: Some(aperture) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gradient_is_that_of_the_mean_path_of_a_full_array() {
        let beside = DVec3::new(0.3, 0.0, 0.0);
        let geometries = [
            Geometry::FixedSource { source: beside },
            Geometry::Monostatic,
            Geometry::Pair { offset: beside },
        ];
        let interfaces = [None, Some(Interface { depth: 0.4, sound_speed: 500.0 })];
        for (geometry, interface) in geometries.into_iter().flat_map(|g| interfaces.map(|i| (g, i))) {
            let aperture = Aperture {
                sound_speed: 343.0,
                band: [10e3, 20e3],
                centre: DVec3::new(0.1, -0.2, 0.0),
                extent: DVec3::new(1.0, 0.6, 0.0),
                geometry,
                interface,
            };
            let at = |i: usize| (i as f64 + 0.5) / 40.0 - 0.5;
            let microphones: Vec<DVec3> =
                (0..1600).map(|i| aperture.centre + DVec3::new(at(i % 40), 0.6 * at(i / 40), 0.0)).collect();
            for p in [DVec3::new(0.0, 0.0, 1.0), DVec3::new(0.5, -0.6, 1.2), DVec3::new(-0.4, 0.4, 2.0)] {
                let path = |p: DVec3, r: DVec3| match interface {
                    None => geometry.path_length(p, r),
                    Some(interface) => interface.path_length(343.0, &geometry, p, r),
                };
                let mean = |p: DVec3| microphones.iter().map(|r| path(p, *r)).sum::<f64>() / 1600.0;
                let expected = (mean(p + DVec3::Z * 1e-5) - mean(p - DVec3::Z * 1e-5)) / 2e-5;
                let got = aperture.path_gradient(p);
                assert!((got - expected).abs() < 3e-3, "{geometry:?} {p}: {got}, not {expected}");
            }
        }
    }
}
