//! Which topic has the scans, and what says where they were taken.

use super::BagOptions;
use super::frames::Way;
use super::messages::Kind;
use super::place::{Placer, Poses};
use super::survey::Survey;
use super::track::Between;

/// Frames that a map's poses may stand in, the better first.
const FIXED_FRAMES: [&str; 2] = ["map", "odom"];

/// Frames of a robot's body, the better first.
const BASE_FRAMES: [&str; 2] = ["base_link", "base_footprint"];

/// What was chosen.
pub(super) struct Choice {
    pub(super) scans: String,
    pub(super) placer: Placer,
    /// What was chosen, in words.
    pub(super) words: String,
}

/// Chooses by the options, and where they leave it open, by what there is one of.
///
/// # Errors
/// Names what there is, and the option that chooses.
pub(super) fn choose(mut survey: Survey, options: &BagOptions) -> Result<Choice, String> {
    let scans = scan_topic(&survey, options)?;
    let laser = survey.scans.get(&scans).map(|scan| scan.frame.clone()).unwrap_or_default();
    let (poses, words) = match &options.pose_topic {
        Some(topic) if survey.topics.get(topic).is_some_and(|topic| topic.kind == Some(Kind::Transforms)) => {
            by_frames(&survey, options, &laser)?
        }
        Some(topic) => by_topic(&mut survey, options, topic, &laser)?,
        None => match by_frames(&survey, options, &laser) {
            Ok(found) => found,
            Err(why) => match the_one(&survey) {
                Some(topic) => by_topic(&mut survey, options, &topic, &laser)?,
                None => {
                    let list = survey.list(Kind::is_pose);
                    let way_out = if list.is_empty() {
                        survey.all()
                    } else {
                        format!("name one of its topics of poses by --pose-topic: {list}")
                    };
                    return Err(format!("{why}; {way_out}"));
                }
            },
        },
    };
    let mut frames = survey.frames;
    let way = match &poses {
        Poses::Frames(way) => way,
        Poses::Topic { mount, .. } => mount,
    };
    frames.keep(way);
    let passed_over = frames.passed_over(way).map(|words| format!("; {words}")).unwrap_or_default();
    let between = Between {
        max_gap: (options.max_gap * 1e9) as i64,
        acceleration: options.max_acceleration.position,
        turn: options.max_acceleration.heading,
        heading_error: options.pose_error.heading,
    };
    let words = format!("scans of {scans} (frame {laser:?}), {words}{passed_over}");
    let placer = Placer { frames, poses, between, pose_error: options.pose_error, sweep: options.sweep };
    Ok(Choice { scans, placer, words })
}

fn scan_topic(survey: &Survey, options: &BagOptions) -> Result<String, String> {
    let topics: Vec<&String> =
        survey.topics.values().filter(|topic| topic.kind == Some(Kind::Scan)).map(|topic| &topic.name).collect();
    if let Some(wanted) = &options.scan_topic {
        return match survey.topics.get(wanted) {
            Some(topic) if topic.kind == Some(Kind::Scan) => Ok(wanted.clone()),
            Some(topic) => {
                Err(format!("the topic {wanted} is of type {}, not sensor_msgs/msg/LaserScan", topic.type_name))
            }
            None => Err(format!("has no topic {wanted} (--scan-topic); {}", survey.all())),
        };
    }
    match topics[..] {
        [only] => Ok(only.clone()),
        [] => {
            let unread = survey.list(|kind| kind == Kind::Scan);
            let why = if unread.is_empty() { survey.all() } else { unread };
            Err(format!("has no topic of sensor_msgs/msg/LaserScan that can be read: {why}"))
        }
        _ => Err(format!(
            "has {} topics of scans: name one by --scan-topic: {}",
            topics.len(),
            survey.list(|kind| kind == Kind::Scan)
        )),
    }
}

/// The one topic of poses: with a covariance, else of odometry, else plain.
fn the_one(survey: &Survey) -> Option<String> {
    [Kind::PoseWithCovariance, Kind::Odometry, Kind::Pose].into_iter().find_map(|kind| {
        let of_kind = |topic: &String| survey.topics.get(topic).is_some_and(|topic| topic.kind == Some(kind));
        let mut topics = survey.poses.keys().filter(|topic| of_kind(topic));
        match (topics.next(), topics.next()) {
            (Some(only), None) => Some(only.clone()),
            _ => None,
        }
    })
}

fn by_frames(survey: &Survey, options: &BagOptions, laser: &str) -> Result<(Poses, String), String> {
    let names = survey.frames.names();
    if names.is_empty() {
        return Err("has no transforms (tf2_msgs/msg/TFMessage on /tf and /tf_static)".to_owned());
    }
    let there = || format!("its frames are {}", names.join(", "));
    let candidates: Vec<&str> = match &options.fixed_frame {
        Some(frame) => vec![frame],
        None => FIXED_FRAMES.into_iter().filter(|frame| names.contains(frame)).collect(),
    };
    if candidates.is_empty() {
        return Err(format!("has no frame \"map\" or \"odom\": name the map's frame by --fixed-frame; {}", there()));
    }
    let mut first = None;
    for fixed in candidates {
        let found = if names.contains(&fixed) {
            survey.frames.way(fixed, laser)
        } else {
            Err(format!("has no frame {fixed:?} (--fixed-frame)"))
        };
        match found {
            Ok(way) if survey.frames.moves(&way) || options.fixed_frame.is_some() => {
                return Ok((Poses::Frames(way), format!("poses of the transforms from {fixed:?} to {laser:?}")));
            }
            Ok(_) => {
                let problem = format!("nothing moves between {fixed:?} and {laser:?}");
                first.get_or_insert(problem);
            }
            Err(problem) => {
                first.get_or_insert(problem);
            }
        }
    }
    Err(format!("{}; {}", first.unwrap_or_default(), there()))
}

fn by_topic(survey: &mut Survey, options: &BagOptions, topic: &str, laser: &str) -> Result<(Poses, String), String> {
    let Some(poses) = survey.poses.remove(topic) else {
        return Err(match survey.topics.get(topic) {
            Some(found) if found.kind.is_some_and(Kind::is_pose) => format!("the topic {topic} has no messages"),
            Some(found) => format!(
                "the topic {topic} is of type {}: poses are nav_msgs/msg/Odometry, geometry_msgs/msg/PoseWithCovarianceStamped \
                 or PoseStamped, and tf2_msgs/msg/TFMessage",
                found.type_name
            ),
            None => format!("has no topic {topic} (--pose-topic); {}", survey.all()),
        });
    };
    if let Some(fault) = poses.fault {
        return Err(format!("a message of {topic}: {fault}"));
    }
    if let Some(fixed) = options.fixed_frame.as_ref().filter(|fixed| **fixed != poses.frame) {
        return Err(format!(
            "the poses of {topic} stand in the frame {:?}, not {fixed:?} (--fixed-frame)",
            poses.frame
        ));
    }
    let mount = mount(survey, options, &poses.child, laser)?;
    let base = mount.0;
    let error = if poses.uncertain {
        "which do not all tell their errors".to_owned()
    } else {
        format!("each within {} standard deviations", options.sigma)
    };
    let passed_over = match poses.passed_over {
        (count, Some(first)) => format!(", of which {count} are passed over ({first})"),
        _ => String::new(),
    };
    let words = format!("poses of {base:?} on {topic} in {:?}, {error}{passed_over}", poses.frame);
    Ok((Poses::Topic { track: poses.track, mount: mount.1, sigma: options.sigma }, words))
}

/// The robot's frame and the way from it to the laser.
fn mount(survey: &Survey, options: &BagOptions, child: &str, laser: &str) -> Result<(String, Way), String> {
    let named = options.base_frame.as_deref().or(Some(child).filter(|child| !child.is_empty()));
    if let Some(base) = named {
        let way = survey.frames.way(base, laser).map_err(|problem| {
            format!("{problem}: how is the laser mounted? Record /tf_static, or name the robot's frame by --base-frame")
        })?;
        return Ok((base.to_owned(), way));
    }
    for base in BASE_FRAMES {
        if let Ok(way) = survey.frames.way(base, laser) {
            return Ok((base.to_owned(), way));
        }
    }
    Err(format!(
        "has no transforms from base_link or base_footprint to {laser:?}, and the poses do not name the robot's frame: name it by \
         --base-frame ({laser:?} where the poses are the laser's own)"
    ))
}
