//! From requests to evidence: every scan checked and computed on its own, on all cores, before the map's writer.

use super::budget::{Budget, Reservation};
use super::failures::map_not_found;
use super::fair::Place;
use super::limits::over;
use super::metrics;
use super::robots::Sighting;
use super::tasks::{Pool, each, mpsc, oneshot};
use super::writer::{Job, Numbered, Published, Request, ScanEvidence};
use super::{InsertAnswer, Rejection, ScanInput, ServiceError, ServiceSettings, setting};
use crate::mapping::{MapConfig, Surveyor};
use crate::quadtree::{BlockMasks, LeafMasks, RowMask};
use crate::sensor::{Angles, PoseBox, Scan, ScanError, ScanSpec, SensorModel};
use crate::store::{MapName, RobotName, SequenceVerdict};
use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Instant;

/// The sensor of scans that name none.
const DEFAULT_SENSOR: &str = "default";

/// Bytes of a decoded scan beside its ranges and angles, about.
const SCAN_OVERHEAD: usize = 512;

thread_local! {
    /// Scratch memory of this thread.
    static SURVEYOR: RefCell<Surveyor> = RefCell::default();
}

/// The threads that compute evidence, and the memory that all requests under way may hold.
pub(super) struct EvidencePool {
    threads: Pool,
    pub(super) budget: Arc<Budget>,
}

/// One request on its way to a map's writer.
pub(super) struct Task {
    pub(super) map: MapName,
    pub(super) config: Arc<MapConfig>,
    /// The root when the request came: what its windows call a duplicate is durable.
    pub(super) published: Arc<Published>,
    pub(super) settings: Arc<ServiceSettings>,
    pub(super) scans: Vec<ScanInput>,
    pub(super) reservation: Reservation,
    /// The request's place in the writer's queue, and the queue.
    pub(super) place: Place,
    pub(super) queue: mpsc::UnboundedSender<Request>,
    pub(super) inside: super::gate::Inside,
    pub(super) reply: oneshot::Sender<Result<InsertAnswer, ServiceError>>,
}

/// What became of one scan before the writer.
enum Prepared {
    Evidence(ScanEvidence),
    /// Of a request that goes to the writer all the same, the writer looks again if a snapshot was restored meanwhile. One
    /// of nothing else is answered at once, with the revision that it was found in.
    Duplicate(usize, Numbered),
    Refused(Rejection),
    /// No memory for its evidence: the whole request goes back.
    Exhausted(ServiceError),
}

/// Why a scan is refused: a stable code and a sentence.
type Refusal = (&'static str, String);

impl EvidencePool {
    pub(super) fn new(settings: &ServiceSettings) -> Result<Self, ServiceError> {
        let threads = Pool::new(settings.evidence_threads)?;
        Ok(Self { threads, budget: Arc::new(Budget::new(settings.max_bytes_in_flight)) })
    }

    /// Computes a request's evidence and hands it to the map's writer. Returns at once.
    pub(super) fn submit(&self, task: Task) {
        self.threads.spawn(move || task.run());
    }
}

/// Bytes that a request's decoded scans take, about.
pub(super) fn input_bytes(scans: &[ScanInput]) -> usize {
    let angles = |angles: &Angles| match angles {
        Angles::Uniform { .. } => 0,
        Angles::Listed(list) => size_of_val(list.as_slice()),
    };
    let one = |scan: &ScanInput| size_of_val(scan.ranges.as_slice()) + angles(&scan.angles) + scan.robot.len();
    scans.iter().map(|scan| SCAN_OVERHEAD + one(scan)).sum()
}

/// Whose turn a request takes: that of the first scan's robot. One whose name is none, which will be refused, is nobody: its
/// text is as long as a body may be, and would be kept.
pub(super) fn counted_as(scans: &[ScanInput]) -> &str {
    scans.first().map(|scan| scan.robot.as_str()).filter(|robot| RobotName::new(robot).is_ok()).unwrap_or_default()
}

impl Task {
    fn run(mut self) {
        if self.reply.is_closed() {
            return; // The client has gone, nothing was promised to it.
        }
        let started = Instant::now();
        let scans = std::mem::take(&mut self.scans);
        let prepared = each(scans, |index, scan| self.prepare(index, scan));
        metrics::evidence(started.elapsed());
        let mut evidence = Vec::with_capacity(prepared.len());
        let mut answer = InsertAnswer { revision: self.published.revision, ..InsertAnswer::default() };
        let mut known = Vec::new();
        let mut exhausted = None;
        for item in prepared {
            match item {
                Prepared::Evidence(scan) => evidence.push(scan),
                Prepared::Duplicate(index, numbered) => {
                    answer.duplicates += 1;
                    known.push((index, numbered));
                }
                Prepared::Refused(rejection) => answer.rejected.push(rejection),
                Prepared::Exhausted(error) => exhausted = Some(error),
            }
        }
        if exhausted.is_none() && !evidence.is_empty() {
            let job = Request::Scans(Job {
                scans: evidence,
                known,
                restored: self.published.restored,
                answer,
                reply: self.reply,
                reservation: self.reservation,
                queued: metrics::Queued::new(),
                inside: self.inside,
                place: Some(self.place),
            });
            if let Err(mpsc::error::SendError(job)) = self.queue.send(job) {
                // The map was deleted meanwhile.
                job.refuse(map_not_found(&self.map));
            }
            return;
        }
        // What the request held is given back before the answer, so that its sender's next request finds it free.
        drop((evidence, self.reservation, self.place));
        if exhausted.is_none() {
            metrics::scans(metrics::Outcome::Duplicate, answer.duplicates);
            metrics::scans(metrics::Outcome::Rejected, answer.rejected.len() as u64);
        }
        // A client that has gone is told nothing.
        let _ = self.reply.send(exhausted.map_or(Ok(answer), Err));
    }

    /// Checks and computes one scan; a panic of the engine is that scan's alone.
    fn prepare(&self, index: usize, input: ScanInput) -> Prepared {
        let robot = match robot(&input) {
            Ok(robot) => robot,
            Err((code, detail)) => {
                metrics::robot_scan(None, metrics::Outcome::Rejected);
                return Prepared::Refused(Rejection { index, code, detail });
            }
        };
        let prepared = self.prepare_of(robot.as_ref(), index, input);
        match &prepared {
            Prepared::Duplicate(..) => metrics::robot_scan(robot.as_ref(), metrics::Outcome::Duplicate),
            Prepared::Refused(_) => metrics::robot_scan(robot.as_ref(), metrics::Outcome::Rejected),
            // The writer counts what becomes of them, and nobody what was not looked at.
            Prepared::Evidence(_) | Prepared::Exhausted(_) => {}
        }
        prepared
    }

    fn prepare_of(&self, robot: Option<&RobotName>, index: usize, input: ScanInput) -> Prepared {
        let refused = |(code, detail): Refusal| Prepared::Refused(Rejection { index, code, detail });
        let sequence = input.sequence;
        let numbered = robot.cloned().zip(sequence).map(|(robot, sequence)| Numbered { robot, sequence });
        // What is known already needs no computing. The writer decides about all others.
        if let Some(number @ Numbered { robot, sequence }) = &numbered
            && let Some(window) = self.published.windows.get(robot)
        {
            match window.verdict(*sequence) {
                SequenceVerdict::New => {}
                SequenceVerdict::Duplicate => return Prepared::Duplicate(index, number.clone()),
                SequenceVerdict::TooOld => return refused(too_old(*sequence, window.highest())),
            }
        }
        let (stamp, sensor) = (input.stamp, sensor_name(&input.sensor).to_owned());
        let computed = shielded(|| self.compute(input)).unwrap_or_else(|| {
            let (robot, sequence) = numbered.as_ref().map_or(("", None), |n| (n.robot.as_str(), Some(n.sequence)));
            tracing::error!(map = %self.map, robot, sequence, index, "computing a scan's evidence panicked");
            Err(("INTERNAL", "the server failed to compute this scan".to_owned()))
        });
        match computed {
            Err(refusal) => refused(refusal),
            Ok((masks, pose)) => match self.reservation.grow(evidence_bytes(&masks)) {
                Ok(()) => {
                    let sighting = robot.cloned().map(|robot| Sighting { robot, sequence, stamp, sensor, pose });
                    Prepared::Evidence(ScanEvidence { index, numbered, sighting, masks })
                }
                Err(error) => Prepared::Exhausted(error),
            },
        }
    }

    fn compute(&self, input: ScanInput) -> Result<(LeafMasks, PoseBox), Refusal> {
        let scan = self.checked(input)?;
        metrics::beams_failed(scan.reading_counts().failed as u64);
        Ok((with_surveyor(|surveyor| surveyor.survey(&self.config, &scan)), *scan.pose()))
    }

    fn checked(&self, input: ScanInput) -> Result<Scan, Refusal> {
        let sensor = self.sensor(&input.sensor)?;
        let pose = input.pose.ok_or_else(|| ("POSE_MISSING", "pose is missing".to_owned()))?;
        let pose = PoseBox::new(pose.x, pose.y, pose.theta, &self.settings.pose).map_err(scan_refusal)?;
        let spec = ScanSpec {
            pose,
            angles: input.angles,
            ranges: input.ranges,
            footprint_radius: input.footprint_radius,
            sweep_rotation: input.sweep_rotation,
            sweep_translation: input.sweep_translation,
        };
        let scan = Scan::new(spec, sensor, &self.settings.scan).map_err(scan_refusal)?;
        Surveyor::fits(&self.config, &scan).map_err(scan_refusal)?;
        if Surveyor::reaches(&self.config, &scan) {
            Ok(scan)
        } else {
            Err(("POSE_OUTSIDE_MAP", "pose: all that the scan can reach lies outside the map's root".to_owned()))
        }
    }

    fn sensor(&self, name: &str) -> Result<SensorModel, Refusal> {
        let name = sensor_name(name);
        self.config.sensors().get(name).copied().ok_or_else(|| {
            let shown: String = name.chars().take(80).collect();
            ("UNKNOWN_SENSOR", format!("sensor {shown:?} is not in the map's configuration"))
        })
    }
}

/// Lends this thread's surveyor. It is out of its place while in use: a panic takes it away, and the next one is new.
pub(super) fn with_surveyor<T>(work: impl FnOnce(&mut Surveyor) -> T) -> T {
    let mut surveyor = SURVEYOR.take();
    let result = work(&mut surveyor);
    SURVEYOR.set(surveyor);
    result
}

/// `None` when the work panicked.
pub(super) fn shielded<T>(work: impl FnOnce() -> T) -> Option<T> {
    catch_unwind(AssertUnwindSafe(work)).ok()
}

/// The robot that a scan names, as one with a sequence must.
fn robot(input: &ScanInput) -> Result<Option<RobotName>, Refusal> {
    if !input.robot.is_empty() {
        return RobotName::new(&input.robot).map(Some).map_err(|e| ("INVALID_ROBOT", format!("robot: {e}")));
    }
    if input.sequence.is_some() {
        return Err(("INVALID_ROBOT", "robot is missing: a scan with a sequence needs it".to_owned()));
    }
    Ok(None)
}

/// The sensor that a scan means.
fn sensor_name(name: &str) -> &str {
    if name.is_empty() { DEFAULT_SENSOR } else { name }
}

/// The refusal of a sequence that its window no longer holds.
pub(super) fn too_old(sequence: u64, highest: Option<u64>) -> Refusal {
    let highest = highest.unwrap_or_default();
    let detail = format!(
        "sequence {sequence} is {} or more behind the highest applied, {highest}: whether it was applied before \
         cannot be told",
        crate::store::WINDOW_LENGTH
    );
    ("SEQUENCE_TOO_OLD", detail)
}

#[expect(clippy::needless_pass_by_value, reason = "the shape that map_err takes")]
fn scan_refusal(error: ScanError) -> Refusal {
    let setting = match &error {
        ScanError::PoseTooWide { field: "pose.theta", .. } => Some(setting::POSE_HEADING),
        ScanError::PoseTooWide { .. } => Some(setting::POSE_WIDTH),
        ScanError::TooManyBeams { .. } => Some(setting::BEAMS_PER_SCAN),
        _ => None,
    };
    (error.code(), setting.map_or_else(|| error.to_string(), |setting| over(setting, &error)))
}

fn evidence_bytes(masks: &LeafMasks) -> usize {
    let block = |masks: &BlockMasks| match masks {
        BlockMasks::AllEmpty => 0,
        BlockMasks::Some { .. } => 2 * size_of::<RowMask>(),
    };
    size_of_val(masks.blocks.as_slice()) + masks.blocks.iter().map(|(_, masks)| block(masks)).sum::<usize>()
}
