//! Whether the camera's pictures have the size that the model was trained on.

use std::fmt;

use wm_model::{Fit, Framing, PictureSize};

/// How the camera's pictures differ from those of the model's training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mismatch {
    /// Width / height differs.
    Aspect {
        /// Size of the camera's pictures.
        found: PictureSize,
        /// Size of the training's pictures.
        trained_on: PictureSize,
        /// How the pictures are brought to the model's aspect.
        fit: Fit,
    },
    /// Width / height is the same, the number of pixels is not.
    Size {
        /// Size of the camera's pictures.
        found: PictureSize,
        /// Size of the training's pictures.
        trained_on: PictureSize,
    },
    /// The pictures are not those that the node views joins.
    Views {
        /// Size of the camera's pictures.
        found: PictureSize,
        /// Size of the model's pictures.
        input: PictureSize,
        /// Cameras side by side in the model's pictures.
        views: usize,
    },
    /// The size of the training's pictures is not known, and the camera's are stretched.
    Stretched {
        /// Size of the camera's pictures.
        found: PictureSize,
        /// Size of the model's pictures.
        input: PictureSize,
    },
}

impl Mismatch {
    /// Compares pictures of the size `found` with a model's training; `None` if they agree.
    pub fn of(
        found: PictureSize,
        framing: Framing,
        trained_on: Option<PictureSize>,
    ) -> Option<Self> {
        let fit = framing.fit;
        let whole = Framing {
            views: 1,
            ..framing
        };
        if framing.views > 1 {
            // The training's cameras may differ in size, so that no size of it is known.
            let (input, views) = (whole.view_size().ok()?, framing.views);
            let is_joined = found == input;
            return (!is_joined).then_some(Self::Views {
                found,
                input,
                views,
            });
        }
        let Some(trained_on) = trained_on else {
            let input = whole.view_size().ok()?;
            let is_stretched = fit.is_stretch() && !found.has_aspect_of(input);
            return is_stretched.then_some(Self::Stretched { found, input });
        };
        if found == trained_on {
            None
        } else if found.has_aspect_of(trained_on) {
            Some(Self::Size { found, trained_on })
        } else {
            Some(Self::Aspect {
                found,
                trained_on,
                fit,
            })
        }
    }

    /// Whether the model sees things in other shapes or places than in its training.
    pub fn is_serious(&self) -> bool {
        matches!(self, Self::Aspect { .. } | Self::Views { .. })
    }

    /// The remedy.
    pub fn fix(&self) -> String {
        match self {
            Self::Aspect { trained_on, .. } | Self::Size { trained_on, .. } => format!(
                "configure the camera's driver to publish {trained_on}, or train a model on this camera's recordings (wm \
                 train model)"
            ),
            Self::Views { .. } => "join the cameras with the node views (cameras:= for wm launch), and subscribe to its \
                 topic"
                .to_owned(),
            Self::Stretched { input, .. } => format!(
                "if the model was trained on pictures of another aspect, configure the camera's driver to publish that \
                 aspect; a new model for {input} crops instead"
            ),
        }
    }
}

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Aspect {
                found,
                trained_on,
                fit,
            } => {
                let effect = match fit {
                    Fit::Stretch => "things are squeezed differently",
                    Fit::Crop => "another part of the scene is cut off",
                    Fit::Pad => "the bars have another size",
                };
                write!(
                    f,
                    "the camera's pictures have {found} pixels, but the model was trained on {trained_on}: the aspect \
                     differs, so that {effect} (fit {fit})"
                )
            }
            Self::Size { found, trained_on } => write!(
                f,
                "the camera's pictures have {found} pixels, the model was trained on {trained_on}: the aspect is the same"
            ),
            Self::Views {
                found,
                input,
                views,
            } => write!(
                f,
                "the camera's pictures have {found} pixels, but the model takes {views} cameras side by side, joined in \
                 {input}"
            ),
            Self::Stretched { found, input } => write!(
                f,
                "the camera's pictures of {found} pixels are stretched to the model's {input}; the size of the training's \
                 pictures is not known"
            ),
        }
    }
}

/// A change of the size of pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SizeChange {
    /// It is the first picture.
    First,
    /// The picture before had another size of the same aspect.
    Size {
        /// The size before.
        from: PictureSize,
    },
    /// The picture before had another aspect: the camera shows another part of the scene.
    Aspect {
        /// The size before.
        from: PictureSize,
    },
}

/// The sizes of the camera's pictures, one after the other.
#[derive(Clone, Debug)]
pub(super) struct PictureSizes {
    framing: Framing,
    trained_on: Option<PictureSize>,
    last: Option<PictureSize>,
}

impl PictureSizes {
    pub(super) fn new(framing: Framing, trained_on: Option<PictureSize>) -> Self {
        Self {
            framing,
            trained_on,
            last: None,
        }
    }

    /// Takes the size of a picture; `None` if it has not changed.
    pub(super) fn take(&mut self, size: PictureSize) -> Option<SizeChange> {
        let Some(from) = self.last.replace(size) else {
            return Some(SizeChange::First);
        };
        if from == size {
            None
        } else if from.has_aspect_of(size) {
            Some(SizeChange::Size { from })
        } else {
            Some(SizeChange::Aspect { from })
        }
    }

    /// How the last picture differs from the training's.
    pub(super) fn mismatch(&self) -> Option<Mismatch> {
        Mismatch::of(self.last?, self.framing, self.trained_on)
    }

    /// The last size and that of the training, in words.
    pub(super) fn in_words(&self) -> String {
        let last = self.last.map_or("none".to_owned(), |size| size.to_string());
        let trained_on = self.trained_on.map(|size| format!("; trained on {size}"));
        let fit = self.framing.fit;
        // Empty if the training size is unknown.
        format!("{last}, fit {fit}{}", trained_on.unwrap_or_default())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    const VGA: PictureSize = size(640, 480);
    const HD: PictureSize = size(1280, 720);

    const fn size(width: u32, height: u32) -> PictureSize {
        PictureSize { width, height }
    }

    fn mismatch(found: PictureSize, fit: Fit, trained_on: Option<PictureSize>) -> Option<Mismatch> {
        Mismatch::of(found, Framing::new((128, 128), fit), trained_on)
    }

    #[test]
    fn another_aspect_than_the_trainings_is_serious() {
        for fit in Fit::ALL {
            assert_eq!(mismatch(VGA, fit, Some(VGA)), None);
            let found = mismatch(HD, fit, Some(VGA)).unwrap();
            assert!(found.is_serious());
            let text = found.to_string();
            for part in ["1280x720", "trained on 640x480", fit.name()] {
                assert!(text.contains(part), "{text}");
            }
            assert!(found.fix().contains("publish 640x480"));
            let larger = mismatch(size(1280, 960), fit, Some(VGA)).unwrap();
            assert!(!larger.is_serious());
            assert!(larger.to_string().contains("the aspect is the same"));
        }
    }

    #[test]
    fn without_a_known_training_only_stretching_is_named() {
        let found = mismatch(HD, Fit::Stretch, None).unwrap();
        assert!(!found.is_serious());
        assert!(
            found
                .to_string()
                .contains("stretched to the model's 128x128")
        );
        assert_eq!(mismatch(size(256, 256), Fit::Stretch, None), None);
        assert_eq!(mismatch(HD, Fit::Crop, None), None);
    }

    #[test]
    fn several_cameras_come_joined() {
        let framing = Framing {
            views: 2,
            ..Framing::new((128, 128), Fit::Crop)
        };
        for trained_on in [None, Some(VGA)] {
            assert_eq!(Mismatch::of(size(128, 128), framing, trained_on), None);
            let found = Mismatch::of(VGA, framing, trained_on).unwrap();
            assert!(found.is_serious());
            assert!(found.to_string().contains("640x480"));
            assert!(found.to_string().contains("2 cameras side by side"));
            assert!(found.fix().contains("views"));
        }
    }

    #[test]
    fn a_size_that_changes_is_noticed_once() {
        let mut sizes = PictureSizes::new(Framing::new((128, 128), Fit::Crop), Some(VGA));
        assert_eq!(sizes.mismatch(), None);
        let seen = [VGA, VGA, HD, HD, size(640, 360), VGA].map(|size| sizes.take(size));
        let expected = [
            Some(SizeChange::First),
            None,
            Some(SizeChange::Aspect { from: VGA }),
            None,
            Some(SizeChange::Size { from: HD }),
            Some(SizeChange::Aspect {
                from: size(640, 360),
            }),
        ];
        assert_eq!(seen, expected);
        assert_eq!(sizes.in_words(), "640x480, fit crop; trained on 640x480");
    }
}
