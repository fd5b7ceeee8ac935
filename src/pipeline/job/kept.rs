//! What the jobs of one process have in common: scenes, their reflectors and their truths, kept from one job to the next.
//!
//! The combinations of a sweep differ in a few keys. A scene is read once for all that leave `[scene]` as it is, its reflectors
//! are placed once for those with the same wavelengths and seed, and its truth is traced once for those with the same pixels.

use super::shared::SharedReflectors;
use crate::config::{RunFile, SceneTable};
use crate::error::Result;
use crate::grid::{DepthMap, Grid};
use crate::pipeline::BareMesh;
use crate::pipeline::memory::SceneSize;
use crate::progress::Observer;
use crate::reflectors::{Reflectors, SurfaceOptions, sample_surface_with};
use crate::scene::{MaterialRule, Scene};
use crate::truth::{TruthOptions, trace_depth_with};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

/// What is known of a scene before a job begins.
#[derive(Clone, Copy, Default)]
pub(in crate::pipeline) struct KnownScene<'a> {
    /// The mesh without a run file from which the run file was made.
    pub(in crate::pipeline) bare: Option<&'a BareMesh>,
    /// What other jobs have kept.
    pub(in crate::pipeline) kept: Option<&'a KeptScenes>,
    /// What other processes of the job have found.
    pub(in crate::pipeline) shared: Option<SharedReflectors<'a>>,
}

impl KnownScene<'_> {
    /// The same for a process whose reflectors others are to have.
    pub(in crate::pipeline) fn shared_with_others(self) -> Self {
        Self { shared: self.shared.map(|shared| SharedReflectors { stores: true, ..shared }), ..self }
    }

    /// The scene of a run file, which `load` reads.
    pub(in crate::pipeline) fn scene(
        self,
        run: &RunFile,
        load: impl FnOnce() -> Result<Arc<Scene>>,
    ) -> Result<Arc<Scene>> {
        let same = |bare: &&BareMesh| bare.run.scene == run.scene && bare.run.materials == run.materials;
        match (self.bare.filter(same), self.kept) {
            (Some(bare), _) => Ok(Arc::clone(&bare.scene)),
            (None, None) => load(),
            (None, Some(kept)) => kept.scenes.get((run.scene.clone(), run.materials.clone()), || {
                load().map(|scene| (Arc::clone(&scene), scene.memory_bytes()))
            }),
        }
    }

    /// The size of a run file's scene, which `find` finds.
    pub(in crate::pipeline) fn size(
        self,
        run: &RunFile,
        find: impl FnOnce() -> Result<SceneSize>,
    ) -> Result<SceneSize> {
        let Some(kept) = self.kept else { return find() };
        kept.sizes.get(run.scene.clone(), || find().map(|size| (size, SMALL_BYTES)))
    }

    /// The reflectors of a scene.
    pub(in crate::pipeline) fn reflectors(
        self,
        scene: &Arc<Scene>,
        options: &SurfaceOptions,
        observer: &dyn Observer,
    ) -> Result<Reflectors> {
        let Some(kept) = self.kept else {
            return match self.shared {
                Some(shared) => shared.reflectors(scene, options, observer),
                None => sample_surface_with(scene, options, observer),
            };
        };
        let sampled = kept.reflectors.get(OfScene(Arc::downgrade(scene), options.clone()), || {
            let sampled = sample_surface_with(scene, options, observer)?;
            let bytes = Reflectors::BYTES_EACH.saturating_mul(sampled.len() as u64);
            Ok((Arc::new(sampled), bytes))
        })?;
        Ok((*sampled).clone())
    }

    /// The true depth of a scene.
    pub(in crate::pipeline) fn truth(
        self,
        scene: &Arc<Scene>,
        grid: &Grid,
        options: &TruthOptions,
        observer: &dyn Observer,
    ) -> Result<DepthMap> {
        let Some(kept) = self.kept else { return trace_depth_with(scene, grid, options, observer) };
        let traced = kept.truths.get(OfScene(Arc::downgrade(scene), (*grid, options.clone())), || {
            let traced = trace_depth_with(scene, grid, options, observer)?;
            let bytes = traced.held_bytes();
            Ok((Arc::new(traced), bytes))
        })?;
        Ok((*traced).clone())
    }

    /// A hash of a scene, which is made once of one that is kept.
    pub(in crate::pipeline) fn fingerprint(self, scene: &Arc<Scene>) -> [u8; 32] {
        let made = || Ok((super::identity::of_surfaces(scene), SMALL_BYTES));
        let made_now = || super::identity::of_surfaces(scene);
        let kept =
            self.kept.and_then(|kept| kept.fingerprints.get(OfScene(Arc::downgrade(scene), ()), made).ok());
        kept.unwrap_or_else(made_now)
    }
}

/// Scenes, reflectors and truths; of each kind so many bytes as jobs may take beside what they need themselves.
#[derive(Debug)]
pub(in crate::pipeline) struct KeptScenes {
    scenes: KeptValues<(SceneTable, Vec<MaterialRule>), Arc<Scene>>,
    reflectors: KeptValues<OfScene<SurfaceOptions>, Arc<Reflectors>>,
    truths: KeptValues<OfScene<(Grid, TruthOptions)>, Arc<DepthMap>>,
    sizes: KeptValues<SceneTable, SceneSize>,
    fingerprints: KeptValues<OfScene<()>, [u8; 32]>,
}

/// Most bytes that are kept of each kind.
const MOST_BYTES: u64 = 128 << 20;

/// What a size and a fingerprint count as, so that there are some thousands at most.
const SMALL_BYTES: u64 = 1 << 16;

impl KeptScenes {
    /// For jobs that may use so many bytes.
    pub(in crate::pipeline) fn within(limit: Option<u64>) -> Self {
        let most = limit.map_or(MOST_BYTES, |limit| MOST_BYTES.min(limit / 16));
        Self {
            scenes: KeptValues::within(most),
            reflectors: KeptValues::within(most),
            truths: KeptValues::within(most),
            sizes: KeptValues::within(most),
            fingerprints: KeptValues::within(most),
        }
    }
}

/// Something that depends on a scene, which is the same only if it is the same in memory; the scene may be forgotten before.
#[derive(Debug)]
struct OfScene<T>(Weak<Scene>, T);

impl<T: PartialEq> PartialEq for OfScene<T> {
    fn eq(&self, other: &Self) -> bool {
        self.0.ptr_eq(&other.0) && self.1 == other.1
    }
}

/// Values by key, those used last at the end; what takes too many bytes together is forgotten from the front, but for the last.
#[derive(Debug)]
struct KeptValues<K, V> {
    entries: Mutex<Vec<Arc<KeptValue<K, V>>>>,
    most: u64,
}

#[derive(Debug)]
struct KeptValue<K, V> {
    key: K,
    /// With its bytes; `None` until it is made.
    value: Mutex<Option<(V, u64)>>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<K: PartialEq, V: Clone> KeptValues<K, V> {
    const fn within(most: u64) -> Self {
        Self { entries: Mutex::new(Vec::new()), most }
    }

    /// The value of a key; `make` makes it, with its bytes, if it is not kept. Whoever wants it meanwhile waits.
    fn get(&self, key: K, make: impl FnOnce() -> Result<(V, u64)>) -> Result<V> {
        let entry = {
            let mut entries = locked(&self.entries);
            let found = entries.iter().position(|entry| entry.key == key).map(|at| entries.remove(at));
            let entry = found.unwrap_or_else(|| Arc::new(KeptValue { key, value: Mutex::new(None) }));
            entries.push(Arc::clone(&entry));
            entry
        };
        let mut value = locked(&entry.value);
        if let Some((value, _)) = &*value {
            return Ok(value.clone());
        }
        let (made, bytes) = make()?;
        *value = Some((made.clone(), bytes));
        drop(value);
        self.forget();
        Ok(made)
    }

    fn forget(&self) {
        let mut entries = locked(&self.entries);
        // One that is being made right now is as good as nothing.
        let bytes = |entry: &Arc<KeptValue<K, V>>| {
            entry.value.try_lock().ok().and_then(|v| Some(v.as_ref()?.1)).unwrap_or(0)
        };
        let mut all: u64 = entries.iter().map(bytes).sum();
        while all > self.most && entries.len() > 1 {
            all -= bytes(&entries.remove(0)).min(all);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::KeptValues;
    use crate::error::Error;
    use std::cell::Cell;

    #[test]
    fn values_are_made_once_and_forgotten_when_they_take_too_much() {
        let kept = KeptValues::<u32, u32>::within(100);
        let made = Cell::new(0);
        let get = |key: u32, bytes: u64| {
            let make = || {
                made.set(made.get() + 1);
                Ok((10 * key, bytes))
            };
            assert_eq!(kept.get(key, make), Ok(10 * key));
            made.get()
        };
        assert_eq!([get(1, 40), get(2, 40), get(1, 40), get(2, 40)], [1, 2, 2, 2]);
        // Of 120 bytes the one that was used longest ago goes: 1.
        assert_eq!([get(3, 40), get(2, 40), get(1, 40)], [3, 3, 4]);
        assert_eq!([get(4, 1000), get(4, 1000), get(1, 40)], [5, 5, 6]);
        let failed = kept.get(5, || Err(Error::Interrupted));
        assert_eq!((failed, get(5, 1)), (Err(Error::Interrupted), 7));
    }
}
