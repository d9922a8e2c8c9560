//! The tree of frames.

use std::collections::{BTreeMap, VecDeque};

use nalgebra::Isometry3;
use thiserror::Error;

use crate::frames::pose::between;

/// Smaller steps back are messages that overtook each other; larger ones mean that the clock was set \[ns\].
const JUMP_NS: i64 = 100_000_000;
/// The most frames: a robot with hands has a hundred.
const MOST_FRAMES: usize = 4096;
/// The most transforms per frame: a second or more, since the slowest frame of a chain decides the time known for all.
const KEPT: usize = 256;
/// A longer chain is a ring.
const MOST_IN_CHAIN: usize = 256;

/// Why a transform is dropped.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum TransformError {
    /// It is older than its predecessor.
    #[error("a transform is {before_s:.3} s older than its predecessor")]
    Older {
        /// By how much \[s\].
        before_s: f64,
    },
    /// There are too many frames.
    #[error("too many frames: dropping {0:?}")]
    TooMany(String),
}

/// Why the pose of one frame in another is unknown.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages explain variants and fields")]
pub enum LookupError {
    /// No transforms connect the two.
    #[error("no transforms lead from {base:?} to {tool:?} yet; the root of {tool:?} is {root:?}")]
    Chain {
        base: String,
        tool: String,
        /// The root above `tool`.
        root: String,
    },
    /// The transforms form a ring.
    #[error("the transforms above {0:?} form a ring")]
    Ring(String),
    /// Only static transforms connect the two.
    #[error("from {base:?} to {tool:?} all transforms are static: the end effector cannot move")]
    Static { base: String, tool: String },
    /// No time is known for all transforms.
    #[error("the transform of {0:?} is not known for a time at which the others are")]
    Time(String),
}

/// A frame in its parent.
#[derive(Clone, Debug)]
struct Edge {
    parent: String,
    is_static: bool,
    /// By stamp \[ns\], at least one.
    known: VecDeque<(i64, Isometry3<f64>)>,
}

/// All frames by name.
#[derive(Clone, Debug, Default)]
pub struct Frames {
    edges: BTreeMap<String, Edge>,
}

/// The name of a frame as in tf2, without the leading slash of old absolute names.
pub fn bare(name: &str) -> &str {
    name.strip_prefix('/').unwrap_or(name)
}

impl Frames {
    /// Takes the transform from a frame to its parent.
    ///
    /// # Errors
    /// Why it is dropped.
    pub fn take(
        &mut self,
        (parent, child): (&str, &str),
        is_static: bool,
        stamp_ns: i64,
        transform: Isometry3<f64>,
    ) -> Result<(), TransformError> {
        let (parent, child) = (bare(parent), bare(child));
        let is_full = self.edges.len() >= MOST_FRAMES;
        let edge = match self.edges.get_mut(child) {
            Some(edge) => edge,
            None if is_full => return Err(TransformError::TooMany(child.to_owned())),
            None => self.edges.entry(child.to_owned()).or_insert_with(|| Edge {
                parent: parent.to_owned(),
                is_static,
                known: VecDeque::new(),
            }),
        };
        if edge.parent != parent || edge.is_static != is_static || is_static {
            parent.clone_into(&mut edge.parent);
            edge.is_static = is_static;
            edge.known.clear();
        }
        if let Some((newest_ns, _)) = edge.known.back() {
            let before_ns = newest_ns.saturating_sub(stamp_ns);
            if before_ns == 0 {
                // several nodes publish the same transform
                return Ok(());
            }
            if before_ns > JUMP_NS {
                edge.known.clear();
            } else if before_ns > 0 {
                return Err(TransformError::Older {
                    before_s: before_ns as f64 / 1e9,
                });
            }
        }
        if edge.known.len() >= KEPT {
            edge.known.pop_front();
        }
        edge.known.push_back((stamp_ns, transform));
        Ok(())
    }

    /// The pose of the moving `tool` in `base` at the newest time known for all transforms \[ns\].
    ///
    /// # Errors
    /// The missing transform.
    pub fn newest(&self, base: &str, tool: &str) -> Result<(i64, Isometry3<f64>), LookupError> {
        let (stamp_ns, pose) = self.find(base, tool)?;
        let is_static = || LookupError::Static {
            base: bare(base).to_owned(),
            tool: bare(tool).to_owned(),
        };
        Ok((stamp_ns.ok_or_else(is_static)?, pose))
    }

    /// The pose of `tool` in `base` at the newest time known for all transforms \[ns\]; no time if all are static.
    ///
    /// # Errors
    /// The missing transform.
    pub fn find(
        &self,
        base: &str,
        tool: &str,
    ) -> Result<(Option<i64>, Isometry3<f64>), LookupError> {
        let (base, tool) = (bare(base), bare(tool));
        let (mut of_base, mut of_tool) = (self.above(base)?, self.above(tool)?);
        // the common part of both chains does not matter
        let mut shared = 0;
        let mut from_root = of_base.iter().rev().zip(of_tool.iter().rev());
        while from_root.next().is_some_and(|(a, b)| a == b) {
            shared += 1;
        }
        if shared == 0 {
            // a chain contains at least the frame itself
            let root = of_tool.last().copied().unwrap_or(tool);
            return Err(LookupError::Chain {
                base: base.to_owned(),
                tool: tool.to_owned(),
                root: root.to_owned(),
            });
        }
        for chain in [&mut of_base, &mut of_tool] {
            chain.truncate(chain.len() - shared);
        }
        let moving = of_base.iter().chain(&of_tool).filter_map(|name| {
            let edge = self.edges.get(*name)?;
            let (newest_ns, _) = edge.known.back()?;
            (!edge.is_static).then_some(*newest_ns)
        });
        let stamp_ns = moving.min();
        let along = |names: &[&str]| {
            names.iter().try_fold(Isometry3::identity(), |below, name| {
                let at = self.at(name, stamp_ns);
                at.map(|at| at * below)
                    .ok_or_else(|| LookupError::Time((*name).to_owned()))
            })
        };
        let (base_in_shared, tool_in_shared) = (along(&of_base)?, along(&of_tool)?);
        Ok((stamp_ns, base_in_shared.inverse() * tool_in_shared))
    }

    /// A frame and its ancestors, the root last.
    fn above<'a>(&'a self, name: &'a str) -> Result<Vec<&'a str>, LookupError> {
        let mut chain = vec![name];
        let mut last = name;
        while let Some(edge) = self.edges.get(last) {
            if chain.len() >= MOST_IN_CHAIN {
                return Err(LookupError::Ring(name.to_owned()));
            }
            last = &edge.parent;
            chain.push(last);
        }
        Ok(chain)
    }

    /// The pose of a frame in its parent at a time.
    fn at(&self, name: &str, stamp_ns: Option<i64>) -> Option<Isometry3<f64>> {
        let edge = self.edges.get(name)?;
        let (newest_ns, newest) = edge.known.back()?;
        let stamp_ns = stamp_ns.filter(|stamp_ns| !edge.is_static && newest_ns != stamp_ns);
        let Some(stamp_ns) = stamp_ns else {
            return Some(*newest);
        };
        let after = edge
            .known
            .partition_point(|(known_ns, _)| *known_ns <= stamp_ns);
        let (from_ns, from) = edge.known.get(after.checked_sub(1)?)?;
        let (to_ns, to) = edge.known.get(after)?;
        let share =
            stamp_ns.saturating_sub(*from_ns) as f64 / to_ns.saturating_sub(*from_ns) as f64;
        Some(between(from, to, share))
    }

    /// Forgets moving transforms, whose times are outdated, and keeps static ones.
    pub fn clear(&mut self) {
        self.edges.retain(|_, edge| edge.is_static);
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    #[test]
    fn static_transforms_are_found_without_a_time() {
        let mut frames = Frames::default();
        let up = Isometry3::translation(0.0, 0.0, 1.0);
        let beside = Isometry3::translation(0.0, 2.0, 0.0);
        for (names, transform) in [(("table", "/base"), up), (("table", "camera"), beside)] {
            assert_eq!(frames.take(names, true, 7, transform), Ok(()));
        }
        let (stamp_ns, pose) = frames.find("camera", "base").unwrap();
        assert_eq!(stamp_ns, None);
        assert_eq!(pose.translation.vector, Vector3::new(0.0, -2.0, 1.0));
        let never = frames.newest("camera", "base");
        assert!(
            matches!(never, Err(LookupError::Static { .. })),
            "{never:?}"
        );
        let hand = Isometry3::translation(0.5, 0.0, 0.0);
        assert_eq!(frames.take(("base", "hand"), false, 9, hand), Ok(()));
        let (stamp_ns, pose) = frames.newest("camera", "hand").unwrap();
        assert_eq!(stamp_ns, 9);
        assert_eq!(pose.translation.vector, Vector3::new(0.5, -2.0, 1.0));
        assert_eq!(
            frames.find("camera", "moon").unwrap_err().to_string(),
            "no transforms lead from \"camera\" to \"moon\" yet; the root of \"moon\" is \"moon\""
        );
    }

    #[test]
    fn old_and_excess_transforms_are_dropped() {
        let mut frames = Frames::default();
        let here = Isometry3::identity();
        assert_eq!(frames.take(("a", "b"), false, 1_000_000_000, here), Ok(()));
        assert_eq!(
            frames.take(("a", "b"), false, 950_000_000, here),
            Err(TransformError::Older { before_s: 0.05 })
        );
        for number in 1..MOST_FRAMES {
            let name = number.to_string();
            assert_eq!(frames.take(("a", &name), true, 0, here), Ok(()));
        }
        let too_many = frames.take(("a", "c"), true, 0, here);
        assert_eq!(too_many, Err(TransformError::TooMany("c".to_owned())));
    }
}
