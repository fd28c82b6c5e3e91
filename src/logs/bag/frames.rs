//! The tree of frames of a bag, of `/tf` and `/tf_static`.

use super::messages::{Stamp, Transform};
use super::track::{Between, Missing, Near, Sample, Track};
use std::collections::BTreeMap;

/// Most frames.
const MOST_FRAMES: usize = 10_000;

/// A way through the tree is not longer: one that is goes in a circle.
const LONGEST_WAY: usize = 256;

/// How a frame stands to its parent.
#[derive(Debug, Clone)]
struct Edge {
    parent: String,
    fixed: Option<Near>,
    track: Track,
    /// Another parent that it had as well: there is no one way by this frame.
    other_parent: Option<String>,
    /// Transforms that are none, and what is wrong with the first.
    passed_over: (u64, Option<String>),
}

/// Every frame with its parent.
#[derive(Debug, Clone, Default)]
pub(super) struct Frames {
    edges: BTreeMap<String, Edge>,
}

/// The way from one frame to another: up, then down.
#[derive(Debug, Clone)]
pub(super) struct Way {
    /// From the first frame up to the common one.
    up: Vec<String>,
    /// From the common one down to the last.
    down: Vec<String>,
}

impl Frames {
    /// Takes a transform; `fixed` for one that holds at all times. What is wrong with a frame matters where a way goes by it.
    ///
    /// # Errors
    /// For more frames than are held.
    pub(super) fn add(&mut self, transform: Transform, fixed: bool) -> Result<(), String> {
        let Transform { stamp, parent, child, parent_from_child } = transform;
        if child == parent {
            // It says nothing.
            return Ok(());
        }
        if !self.edges.contains_key(&child) && self.edges.len() >= MOST_FRAMES {
            return Err(format!("has more than {MOST_FRAMES} frames"));
        }
        let edge = self.edges.entry(child).or_insert_with(|| Edge {
            parent: parent.clone(),
            fixed: None,
            track: Track::default(),
            other_parent: None,
            passed_over: (0, None),
        });
        if edge.parent != parent {
            edge.other_parent.get_or_insert(parent);
            return Ok(());
        }
        match parent_from_child {
            Ok(pose) if fixed => edge.fixed = Some(Near::exact(pose)),
            Ok(pose) => edge.track.push(Sample { stamp, pose, variances: None }),
            Err(problem) => {
                edge.passed_over.0 += 1;
                edge.passed_over.1.get_or_insert(problem);
            }
        }
        Ok(())
    }

    /// Orders all samples.
    pub(super) fn settle(&mut self) {
        self.edges.values_mut().for_each(|edge| edge.track.settle());
    }

    /// The names of all frames.
    pub(super) fn names(&self) -> Vec<&str> {
        let mut names: Vec<&str> =
            self.edges.iter().flat_map(|(child, edge)| [child.as_str(), edge.parent.as_str()]).collect();
        names.sort_unstable();
        names.dedup();
        names
    }

    /// A frame and those above it, up to the root.
    fn above(&self, frame: &str) -> Result<Vec<String>, String> {
        let mut way = vec![frame.to_owned()];
        let mut here = frame;
        while let Some(edge) = self.edges.get(here) {
            if let Some(other) = &edge.other_parent {
                return Err(format!("the frame {here:?} has two parents, {:?} and {other:?}", edge.parent));
            }
            if way.len() > LONGEST_WAY {
                return Err(format!("the frames above {frame:?} go in a circle"));
            }
            here = &edge.parent;
            way.push(here.to_owned());
        }
        Ok(way)
    }

    /// The way between two frames.
    ///
    /// # Errors
    /// Names what there is where they are not connected.
    pub(super) fn way(&self, from: &str, to: &str) -> Result<Way, String> {
        let (mut up, mut down) = (self.above(from)?, self.above(to)?);
        let Some(common) = up.iter().find(|frame| down.contains(frame)).cloned() else {
            return Err(format!(
                "no transforms lead from {from:?} to {to:?}: {from:?} hangs on {:?}, {to:?} on {:?}",
                up.last().map_or("", String::as_str),
                down.last().map_or("", String::as_str)
            ));
        };
        let until = |way: &mut Vec<String>| way.truncate(way.iter().position(|frame| *frame == common).unwrap_or(0));
        until(&mut up);
        until(&mut down);
        down.reverse();
        Ok(Way { up, down })
    }

    /// How many transforms along the way are none, with the first that is.
    pub(super) fn passed_over(&self, way: &Way) -> Option<String> {
        let edges = || way.up.iter().chain(&way.down).filter_map(|frame| self.edges.get(frame));
        let count: u64 = edges().map(|edge| edge.passed_over.0).sum();
        let first = edges().find_map(|edge| edge.passed_over.1.as_ref())?;
        Some(format!("{count} of the transforms are passed over: {first}"))
    }

    /// Does the way move?
    pub(super) fn moves(&self, way: &Way) -> bool {
        way.up.iter().chain(&way.down).filter_map(|frame| self.edges.get(frame)).any(|edge| edge.fixed.is_none())
    }

    /// Where the last frame of a way is in the first at a time, and how far it is from the last frame on the way that moves,
    /// metres: what it swings with.
    pub(super) fn along(&self, way: &Way, stamp: Stamp, between: &Between) -> Result<(Near, f64), Missing> {
        let mut here = Near::exact(nalgebra::Isometry3::identity());
        let mut arm = here;
        let mut first = true;
        let mut step = |edge: Near, moves: bool| {
            // An identity in front would round for nothing.
            here = if first { edge } else { here.then(&edge) };
            arm = if moves { Near::exact(nalgebra::Isometry3::identity()) } else { arm.then(&edge) };
            first = false;
        };
        for frame in &way.up {
            let (edge, moves) = self.edge(frame, stamp, between)?;
            step(edge.inverse(), moves);
        }
        for frame in &way.down {
            let (edge, moves) = self.edge(frame, stamp, between)?;
            step(edge, moves);
        }
        Ok((here, arm.pose.translation.vector.norm()))
    }

    /// The poses of the last frame on a way that moves.
    pub(super) fn carrier(&self, way: &Way) -> Option<&Track> {
        let edges = way.up.iter().chain(&way.down).rev().filter_map(|frame| self.edges.get(frame));
        edges.filter(|edge| edge.fixed.is_none()).map(|edge| &edge.track).next()
    }

    /// A frame in its parent, and whether it moves.
    fn edge(&self, frame: &str, stamp: Stamp, between: &Between) -> Result<(Near, bool), Missing> {
        let Some(edge) = self.edges.get(frame) else { return Err(Missing::Before) };
        match edge.fixed {
            Some(fixed) => Ok((fixed, false)),
            None => Ok((edge.track.at(stamp, between)?.near, true)),
        }
    }

    /// Forgets all frames that the way does not go by.
    pub(super) fn keep(&mut self, way: &Way) {
        self.edges.retain(|frame, _| way.up.contains(frame) || way.down.contains(frame));
    }
}
