//! Offline mapping: the evidence of many scans in parallel, applied one after the other in their order.

use crate::mapping::{MapConfig, Surveyor};
use crate::quadtree::{LeafMasks, OccupancyTree};
use crate::sensor::Scan;
use rayon::ThreadPool;
use rayon::prelude::*;
use rustix::time::{ClockId, clock_gettime};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Scans whose evidence is held at once: enough to keep every core busy, few enough to stay in cache.
pub(super) const BATCH: usize = 256;

/// Scans of a batch whose evidence is computed together.
const STAGE: usize = 64;

/// Builds a map from scans and measures the processor time that it takes.
pub(super) struct Mapper {
    config: MapConfig,
    tree: OccupancyTree,
    /// `None` for one thread: everything happens on the caller's.
    pool: Option<ThreadPool>,
    /// One a thread.
    surveyors: Vec<Mutex<Surveyor>>,
    busy: Duration,
    scans: u64,
    beams: u64,
}

impl Mapper {
    /// An empty map.
    ///
    /// # Errors
    /// When the threads cannot be started.
    pub(super) fn new(config: MapConfig, threads: usize) -> anyhow::Result<Self> {
        let pool = match threads {
            1 => None,
            _ => Some(rayon::ThreadPoolBuilder::new().num_threads(threads).build()?),
        };
        let tree = OccupancyTree::new(config.grid().depth(), config.scale());
        let surveyors = (0..threads.max(1)).map(|_| Mutex::new(Surveyor::new())).collect();
        Ok(Self { config, tree, pool, surveyors, busy: Duration::ZERO, scans: 0, beams: 0 })
    }

    /// Adds scans in their order.
    pub(super) fn add(&mut self, scans: &[Scan]) {
        let before = processor_time();
        let Self { config, tree, pool, surveyors, .. } = self;
        if let Some(pool) = pool {
            // While the evidence of one stage is computed, that of the stage before is applied.
            pool.install(|| {
                let mut before: Vec<LeafMasks> = Vec::new();
                for stage in scans.chunks(STAGE) {
                    let evidence = || stage.par_iter().map(|scan| survey(surveyors, config, scan)).collect();
                    before = rayon::join(|| apply(tree, &before), evidence).1;
                }
                apply(tree, &before);
            });
        } else {
            let mut masks = LeafMasks::default();
            for scan in scans {
                surveyor(surveyors).survey_into(config, scan, &mut masks);
                apply(tree, std::slice::from_ref(&masks));
            }
        }
        self.busy += processor_time().saturating_sub(before);
        self.scans += scans.len() as u64;
        self.beams += scans.iter().map(|scan| scan.beams() as u64).sum::<u64>();
    }

    /// The map.
    pub(super) fn tree(&self) -> &OccupancyTree {
        &self.tree
    }

    /// Its configuration.
    pub(super) fn config(&self) -> &MapConfig {
        &self.config
    }

    /// Scans added.
    pub(super) fn scans(&self) -> u64 {
        self.scans
    }

    /// Beams of the scans added.
    pub(super) fn beams(&self) -> u64 {
        self.beams
    }

    /// Processor time of all threads in [`Mapper::add`]: evidence and apply.
    pub(super) fn busy(&self) -> Duration {
        self.busy
    }
}

/// Nobody asks here which blocks changed.
fn apply(tree: &mut OccupancyTree, evidence: &[LeafMasks]) {
    let mut changed = Vec::new();
    for masks in evidence {
        changed.clear();
        tree.apply(masks, &mut changed);
    }
}

fn survey(surveyors: &[Mutex<Surveyor>], config: &MapConfig, scan: &Scan) -> LeafMasks {
    surveyor(surveyors).survey(config, scan)
}

/// This thread's surveyor.
fn surveyor(surveyors: &[Mutex<Surveyor>]) -> MutexGuard<'_, Surveyor> {
    let thread = rayon::current_thread_index().unwrap_or(0) % surveyors.len();
    // A surveyor is scratch memory, prepared anew for every scan: one left behind by a panic serves as well.
    surveyors[thread].lock().unwrap_or_else(PoisonError::into_inner)
}

/// Processor time of this process so far, all its threads together.
fn processor_time() -> Duration {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    Duration::new(u64::try_from(time.tv_sec).unwrap_or(0), u32::try_from(time.tv_nsec).unwrap_or(0))
}
