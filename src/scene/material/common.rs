//! Common materials, by what they do to sound of 4 to 20 kHz.

use crate::choice::choice;

choice! {
    /// A common material. Reflectance is √(1 − α − τ²), with α the share of the energy that is absorbed at 4 kHz, the highest
    /// octave of the tables, and τ the share of the amplitude that passes.
    ///
    /// α is of the table "Absorption coefficients of building materials and finishes" in L. L. Beranek, *Acoustics* (1954),
    /// which later textbooks repeat; τ of plates follows from the mass law, 20 lg(f m) − 47 dB at 10 kHz.
    pub enum CommonMaterial: "material" {
        /// A window pane or a plate: α 0.02; 4 mm, 10 kg/m², let a thousandth through.
        Glass = "glass",
        /// Rough concrete, brick or stone: α 0.04.
        Concrete = "concrete",
        /// Wooden panels and furniture: α 0.11; 10 mm, 6 kg/m², let 0.004 through.
        Wood = "wood",
        /// A heavy curtain in folds: α 0.65; it lets 20 dB less than everything through.
        Curtain = "curtain",
        /// Open-cell foam, 25 mm before a wall: α 0.95.
        Foam = "foam",
        /// Loudspeaker cloth and mesh fabric, which take less than 1 dB: τ 0.93.
        MeshFabric = "mesh-fabric",
    }
}

impl CommonMaterial {
    /// Reflectance and transmittance, shares of the amplitude.
    pub const fn shares(self) -> [f64; 2] {
        match self {
            Self::Glass => [0.99, 0.0],
            Self::Concrete => [0.98, 0.0],
            Self::Wood => [0.94, 0.0],
            Self::Curtain => [0.58, 0.1],
            Self::Foam => [0.22, 0.0],
            Self::MeshFabric => [0.1, 0.93],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_material_gives_more_than_it_gets() {
        for material in CommonMaterial::ALL {
            let [reflectance, transmittance] = material.shares();
            let energy = reflectance * reflectance + transmittance * transmittance;
            assert!((0.0..=1.0).contains(&energy) && reflectance > 0.0, "{material}: {energy}");
        }
        // √(1 − α − τ²) of the curtain and the foam.
        for (material, absorbed) in [(CommonMaterial::Curtain, 0.65_f64), (CommonMaterial::Foam, 0.95)] {
            let [reflectance, transmittance] = material.shares();
            assert!((reflectance - (1.0 - absorbed - transmittance * transmittance).sqrt()).abs() < 0.01);
        }
    }
}
