//! Sizes of the pictures in the bags, and whether prepared pictures suit a model.

use std::{collections::BTreeMap, path::Path};

use serde::{Deserialize, Serialize};
use wm_model::{Fit, PictureSize};

use crate::{DatasetError, Manifest, Size};

/// Number of a camera's pictures with one size.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SourceSize {
    /// Topic of the camera, without transport.
    pub camera: String,
    /// Size of the pictures in the bags.
    pub size: PictureSize,
    /// Number of pictures.
    pub pictures: u64,
}

/// Number of pictures by camera index and size.
pub(crate) type SizeCounts = BTreeMap<(usize, PictureSize), u64>;

/// Sizes by camera.
pub(crate) fn source_sizes(counts: &SizeCounts, cameras: &[String]) -> Vec<SourceSize> {
    let named = counts.iter().filter_map(|((view, size), pictures)| {
        Some(SourceSize {
            camera: cameras.get(*view)?.clone(),
            size: *size,
            pictures: *pictures,
        })
    });
    named.collect()
}

impl From<Size> for PictureSize {
    fn from(size: Size) -> Self {
        // A side is at most 4096.
        Self {
            width: size.width as u32,
            height: size.height as u32,
        }
    }
}

impl Manifest {
    /// Size of all pictures in the bags; `None` if it varies, or was not recorded.
    #[must_use]
    pub fn picture_size(&self) -> Option<PictureSize> {
        let first = self.source_sizes.first()?.size;
        let is_first = |source: &SourceSize| source.size == first;
        self.source_sizes.iter().all(is_first).then_some(first)
    }

    /// Descriptions of cameras with pictures of several sizes.
    pub(crate) fn mixed_sizes(&self) -> Vec<String> {
        let of_camera = |camera: &String| {
            let own = self.source_sizes.iter().filter(|s| s.camera == *camera);
            let own: Vec<String> = own
                .map(|s| format!("{} ({} pictures)", s.size, s.pictures))
                .collect();
            let text = format!(
                "{camera} has pictures of several sizes: {}; each is prepared separately (fit {}), so the model sees \
                 the scene at several scales",
                own.join(", "),
                self.fit
            );
            (own.len() > 1).then_some(text)
        };
        self.cameras.iter().filter_map(of_camera).collect()
    }

    /// Rejects prepared pictures that show another part of the camera's picture than `fit` at `size`.
    pub(crate) fn expect_fit(&self, dir: &Path, size: Size, fit: Fit) -> Result<(), DatasetError> {
        let (stored, wanted) = (PictureSize::from(self.size), PictureSize::from(size));
        let is_alike = stored.has_aspect_of(wanted);
        // Every fit gives the same picture.
        let is_whole = is_alike
            && !self.source_sizes.is_empty()
            && self
                .source_sizes
                .iter()
                .all(|s| s.size.has_aspect_of(wanted));
        let fits = fit == self.fit && (is_alike || fit.is_stretch());
        if fits || is_whole {
            return Ok(());
        }
        let sizes = self.source_sizes.iter().map(|s| s.size.to_string());
        let mut sizes: Vec<String> = sizes.collect();
        sizes.sort();
        sizes.dedup();
        let from = match sizes.is_empty() {
            true => "pictures of an unrecorded size".to_owned(),
            false => format!("pictures of {}", sizes.join(", ")),
        };
        Err(DatasetError::Prepared {
            dir: dir.to_owned(),
            what: format!(
                "prepared with fit {} at {} from {from}, but the model takes fit {fit} at {size}; prepare the bags again \
                 with --fit {fit} --size {size}, or train an encoder with --fit {}",
                self.fit, self.size, self.fit
            ),
        })
    }
}
