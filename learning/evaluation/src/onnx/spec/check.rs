//! Checks a description against its role.

use crate::onnx::{Input, InputKind, Layout, OutputKind, Pooling, Resize, Role, Size, Spec};

/// Larger sides are a mistake: a batch would not fit into memory.
const MAX_SIDE: usize = 4096;
/// Likewise for pictures per clip and inputs per run.
const MAX_FRAMES: usize = 256;
pub(crate) const MAX_BATCH: usize = 64;

/// The wrong key, and the reason.
type Wrong = (&'static str, String);

impl Spec {
    /// Fills in the role's defaults; names a key that does not suit the role.
    pub(crate) fn checked(mut self, role: Role) -> Result<Self, Wrong> {
        if !(1..=MAX_BATCH).contains(&self.batch) {
            return Err((
                "batch",
                format!("expected 1 to {MAX_BATCH}, found {}", self.batch),
            ));
        }
        if self.pooling != Pooling::None && role.output() != OutputKind::Features {
            return Err(("pooling", "is for features only".to_owned()));
        }
        self.check_scores(role)?;
        self.check_tracks(role)?;
        self.input = self.input.checked(role)?;
        Ok(self)
    }

    fn check_scores(&mut self, role: Role) -> Result<(), Wrong> {
        const KEY: &str = "score_range";
        match (role, self.score_range) {
            (Role::Musiq, None) => {
                return Err((
                    KEY,
                    "is missing: the scores of the worst and the best picture".to_owned(),
                ));
            }
            (Role::Aesthetic, None) => self.score_range = Some([0.0, 10.0]),
            (Role::Musiq | Role::Aesthetic, Some([worst, best])) => {
                if !(worst.is_finite() && best.is_finite() && worst != best) {
                    return Err((
                        KEY,
                        format!("expected two numbers, found [{worst}, {best}]"),
                    ));
                }
            }
            (_, Some(_)) => return Err((KEY, "is for musiq and aesthetic only".to_owned())),
            (_, None) => {}
        }
        Ok(())
    }

    fn check_tracks(&self, role: Role) -> Result<(), Wrong> {
        let only = || "is for tracks only".to_owned();
        if role == Role::Tracks {
            return match self.visible_above {
                Some(limit) if !limit.is_finite() => {
                    Err(("visible_above", format!("expected a number, found {limit}")))
                }
                _ => Ok(()),
            };
        }
        if self.visibility.is_some() {
            return Err(("visibility", only()));
        }
        if self.visible_above.is_some() {
            return Err(("visible_above", only()));
        }
        Ok(())
    }
}

impl Input {
    fn checked(mut self, role: Role) -> Result<Self, Wrong> {
        self.check_resize()?;
        self.check_size(role)?;
        self.check_levels()?;
        self.frames = self.checked_frames(role)?;
        self.layout = Some(self.checked_layout(role)?);
        Ok(self)
    }

    fn check_resize(&self) -> Result<(), Wrong> {
        match (self.resize, self.antialias) {
            (Resize::Bilinear | Resize::Bicubic, None) => Err((
                "input.antialias",
                "is missing: it changes metrics, so give true or false".to_owned(),
            )),
            (Resize::Nearest | Resize::None, Some(true)) => Err((
                "input.antialias",
                "is for bilinear and bicubic only".to_owned(),
            )),
            (Resize::Bilinear | Resize::Bicubic | Resize::Nearest, _) if self.size.is_none() => {
                Err((
                    "input.size",
                    "is missing; without resizing, give `resize: none`".to_owned(),
                ))
            }
            _ => Ok(()),
        }
    }

    fn check_size(&self, role: Role) -> Result<(), Wrong> {
        let sides = |key, sides: &[usize]| match sides
            .iter()
            .find(|side| !(1..=MAX_SIDE).contains(*side))
        {
            Some(side) => Err((key, format!("expected 1 to {MAX_SIDE}, found {side}"))),
            None => Ok(()),
        };
        match self.size {
            Some(Size::Shorter(side)) => sides("input.size", &[side])?,
            Some(Size::Exact(size)) => sides("input.size", &size)?,
            None => {}
        }
        if let Some(crop) = self.crop {
            sides("input.crop", &crop)?;
            if role.is_on_the_picture() {
                return Err(("input.crop", format!("{role} needs the whole picture")));
            }
        }
        Ok(())
    }

    fn check_levels(&self) -> Result<(), Wrong> {
        let [low, high] = self.range;
        if !(low.is_finite() && high.is_finite() && low != high) {
            return Err((
                "input.range",
                format!("expected two numbers, found [{low}, {high}]"),
            ));
        }
        if !self.mean.iter().all(|mean| mean.is_finite()) {
            return Err((
                "input.mean",
                format!("expected numbers, found {:?}", self.mean),
            ));
        }
        if !self.std.iter().all(|std| std.is_finite() && *std != 0.0) {
            return Err((
                "input.std",
                format!("expected numbers other than 0, found {:?}", self.std),
            ));
        }
        Ok(())
    }

    fn checked_frames(&self, role: Role) -> Result<Option<usize>, Wrong> {
        match (role.input(), self.frames) {
            (InputKind::Clip, None) => Ok(Some(16)),
            (InputKind::Clip | InputKind::PictureOrClip, Some(frames)) => {
                if (1..=MAX_FRAMES).contains(&frames) {
                    Ok(Some(frames))
                } else {
                    Err((
                        "input.frames",
                        format!("expected 1 to {MAX_FRAMES}, found {frames}"),
                    ))
                }
            }
            (_, Some(_)) => Err((
                "input.frames",
                format!("{role} takes no clips of a fixed length"),
            )),
            (_, None) => Ok(None),
        }
    }

    fn checked_layout(&self, role: Role) -> Result<Layout, Wrong> {
        use Layout::{Nchw, Ncthw, Nhwc, Ntchw};
        let (default, other) = match (role.input(), self.frames) {
            (InputKind::Queries, _) => (Ntchw, Ncthw),
            (InputKind::Clip, _) | (InputKind::PictureOrClip, Some(_)) => (Ncthw, Ntchw),
            _ => (Nchw, Nhwc),
        };
        let layout = self.layout.unwrap_or(default);
        if layout == default || layout == other {
            return Ok(layout);
        }
        Err((
            "input.layout",
            format!("expected {default} or {other}, found {layout}"),
        ))
    }
}

impl std::fmt::Display for Layout {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Nchw => "nchw",
            Self::Nhwc => "nhwc",
            Self::Ncthw => "ncthw",
            Self::Ntchw => "ntchw",
        })
    }
}
