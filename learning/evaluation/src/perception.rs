//! Metrics of decoded rollouts by the user's networks (the paper, appendix C.2): LPIPS, FID, FVD, JEPA similarity,
//! image and aesthetic quality, consistency, motion, depth, and tracked points.
//!
//! [`Perception`] has the networks, opened once for all threads. [`Perception::measure`] processes one rollout, and
//! [`summarise`] makes findings of many from the records alone. Metrics of a role without a network are reported as
//! missing by name.
//!
//! # Contents of a record
//!
//! For each figure a number, or a list with one number per step. For FID, FVD and JEPA the features themselves, since a
//! distance needs all episodes. Features of predictions, reconstructions and true frames dominate: 4/3 of 4 bytes each
//! in base64. A rollout of 45 steps has 1.5 MB of Inception's 2048 features per frame, and 16 KB of 512 features of two
//! clips. A thousand such episodes are 1.5 GB of records, which `wm eval merge` holds in memory.

mod arguments;
mod depth;
mod episode;
mod episode_figure;
mod feature_space;
mod frame_features;
mod learned_distance;
mod motion;
mod points;
mod rollout_pictures;
mod summary;
mod temporal;
mod vectors;

use std::collections::BTreeMap;

use crate::onnx::{Depth, Digest, Features, Flow, Network, Networks, Role, Scores, Tracks};
use anyhow::{Context as _, Result};
use image::RgbImage;
use serde_json::{Map, Value};
use wm_metrics::{Table, motion::feature_consistency};

pub use arguments::PerceptionArgs;
pub use episode::{BySource, EpisodePerception, Values};
pub use episode_figure::EpisodeFigure;
pub use feature_space::FeatureSpace;
pub use rollout_pictures::RolloutPictures;
pub use summary::summarise;
pub use vectors::Vectors;

use frame_features::FrameFeatures;
use learned_distance::LearnedDistance;

/// The open networks.
#[derive(Debug, Default)]
pub struct Perception {
    lpips: Option<LearnedDistance>,
    spaces: BTreeMap<FeatureSpace, FrameFeatures>,
    image_quality: Option<Scores>,
    aesthetic_quality: Option<Scores>,
    subject: Option<Features>,
    background: Option<Features>,
    flow: Option<Flow>,
    depth: Option<Depth>,
    tracks: Option<Tracks>,
    /// Description for the header.
    description: Option<Value>,
}

impl Perception {
    /// Opens all networks of `arguments`.
    ///
    /// # Errors
    /// Names the role and the unusable file.
    pub fn open(arguments: &PerceptionArgs) -> Result<Self> {
        let mut found = Self::default();
        let mut description = Map::new();
        if let Some(file) = &arguments.networks {
            let text = std::fs::read_to_string(file).with_context(|| file.display().to_string())?;
            let digests = found.open_all(&Networks::parse(&text, file)?)?;
            description.insert("file".into(), text.into());
            description.insert("sha256".into(), digests.into());
        }
        if let Some(folder) = &arguments.lpips {
            anyhow::ensure!(
                found.lpips.is_none(),
                "--networks has a network for `lpips` too: give one or the other"
            );
            let (lpips, digests) = LearnedDistance::open(folder)?;
            found.lpips = Some(lpips);
            description.insert("lpips".into(), digests);
        }
        found.description = (!description.is_empty()).then(|| description.into());
        Ok(found)
    }

    /// File and digests of the networks, as in results; `None` without networks.
    #[must_use]
    pub fn description(&self) -> Option<&Value> {
        self.description.as_ref()
    }

    /// Metrics of one rollout.
    ///
    /// # Errors
    /// If a network cannot process the pictures.
    pub fn measure(&self, pictures: &RolloutPictures<'_>) -> Result<EpisodePerception> {
        let predicted = pictures.predicted;
        let mut found = EpisodePerception::default();
        if let Some(lpips) = &self.lpips {
            let values = pictures.both(|video| lpips.between(video.iter().zip(pictures.truth)))?;
            found.keep(EpisodeFigure::Lpips, Ok::<_, String>(values));
        }
        if let (Some(lpips), Some(flow)) = (&self.lpips, &self.flow) {
            let values = temporal::measure(lpips, flow, pictures)?;
            found.keep(EpisodeFigure::TLpips, values);
        }
        for (figure, network) in [
            (EpisodeFigure::ImageQuality, &self.image_quality),
            (EpisodeFigure::AestheticQuality, &self.aesthetic_quality),
        ] {
            if let Some(network) = network {
                let scores = network.of(predicted)?.into_iter();
                let scores = scores.map(|score| f64::from(score.normalised)).collect();
                found.keep(figure, Ok::<_, String>(Values::of(scores)));
            }
        }
        for (figure, network) in [
            (EpisodeFigure::SubjectConsistency, &self.subject),
            (EpisodeFigure::BackgroundConsistency, &self.background),
        ] {
            if let Some(network) = network {
                let consistency = Table::from_rows(network.of(predicted)?)
                    .and_then(|features| feature_consistency(&features));
                found.keep(figure, consistency.map(|value| Values::of(vec![value])));
            }
        }
        if let Some(flow) = &self.flow {
            motion::measure(flow, predicted, &mut found)?;
        }
        if let Some(network) = &self.depth {
            found.keep(
                EpisodeFigure::DepthAbsRel,
                depth::measure(network, pictures)?,
            );
        }
        if let Some(network) = &self.tracks {
            let coverage = points::coverage(network, pictures)?;
            found.keep(EpisodeFigure::PckCoverage, coverage.map(Values::of));
        }
        for (space, network) in &self.spaces {
            let of = |video: &[RgbImage]| Vectors::of(&network.of(video)?);
            if let Some(why) = network.too_few(predicted.len()) {
                found.lack(space.name(), why);
                continue;
            }
            let of = BySource {
                truth: of(pictures.truth)?,
                predicted: of(predicted)?,
                reconstructed: of(pictures.reconstructed)?,
            };
            found.features.insert(*space, of);
        }
        Ok(found)
    }

    /// Opens the networks of a file; returns their digests.
    fn open_all(&mut self, networks: &Networks) -> Result<Map<String, Value>> {
        let mut digests = Map::new();
        for role in networks.present() {
            let digest = match role {
                Role::Lpips => {
                    let network = networks.distance()?;
                    let digest = network.network().digest();
                    self.lpips = Some(LearnedDistance::Network(Box::new(network)));
                    digest
                }
                Role::Fid | Role::Fvd | Role::Jepa => {
                    let network = FrameFeatures::open(networks, role)?;
                    let digest = network.network().digest();
                    let space = FeatureSpace::ALL
                        .into_iter()
                        .find(|space| space.role() == role);
                    self.spaces.extend(space.map(|space| (space, network)));
                    digest
                }
                Role::Musiq => kept(
                    &mut self.image_quality,
                    networks.scores(role)?,
                    Scores::network,
                ),
                Role::Aesthetic => kept(
                    &mut self.aesthetic_quality,
                    networks.scores(role)?,
                    Scores::network,
                ),
                Role::Subject => kept(
                    &mut self.subject,
                    networks.features(role)?,
                    Features::network,
                ),
                Role::Background => kept(
                    &mut self.background,
                    networks.features(role)?,
                    Features::network,
                ),
                Role::Flow => kept(&mut self.flow, networks.flow()?, Flow::network),
                Role::Depth => kept(&mut self.depth, networks.depth()?, Depth::network),
                Role::Tracks => kept(&mut self.tracks, networks.tracks()?, Tracks::network),
            };
            digests.insert(role.name().to_owned(), digest.to_string().into());
        }
        Ok(digests)
    }
}

/// Stores an open network; returns its file's digest.
fn kept<T>(place: &mut Option<T>, opened: T, network: impl Fn(&T) -> &Network) -> Digest {
    let digest = network(&opened).digest();
    *place = Some(opened);
    digest
}

#[cfg(test)]
mod tests;
