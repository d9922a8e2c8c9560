//! The user's networks.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::onnx::{
    ClipFeatures, Depth, Distance, Error, Features, Flow, Network, Result, Role, Scores, Spec,
    Tracks,
};

/// Contents of a `networks.yaml`: the networks by role. Opens their files on request only.
#[derive(Clone, Debug)]
pub struct Networks {
    file: PathBuf,
    specs: BTreeMap<Role, Spec>,
}

/// A struct instead of a map, so that repeated roles are errors, and wrong ones list the right ones.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Roles {
    lpips: Option<Spec>,
    fid: Option<Spec>,
    fvd: Option<Spec>,
    musiq: Option<Spec>,
    aesthetic: Option<Spec>,
    jepa: Option<Spec>,
    subject: Option<Spec>,
    background: Option<Spec>,
    flow: Option<Spec>,
    depth: Option<Spec>,
    tracks: Option<Spec>,
}

impl Networks {
    /// No networks. Messages name `file` as the place to add them.
    pub fn none(file: impl Into<PathBuf>) -> Self {
        Self {
            file: file.into(),
            specs: BTreeMap::new(),
        }
    }

    /// Reads `networks.yaml`, without opening the networks.
    pub fn read(file: impl Into<PathBuf>) -> Result<Self> {
        let file = file.into();
        match fs::read_to_string(&file) {
            Ok(text) => Self::parse(&text, file),
            Err(reason) => Err(Error::Io { file, reason }),
        }
    }

    /// Parses a text. Its paths are relative to the folder of `file`.
    ///
    /// ```
    /// use wm_evaluation::onnx::{Networks, Role};
    ///
    /// # fn main() -> wm_evaluation::onnx::Result<()> {
    /// let text = "
    /// fid:
    ///   file: inception.onnx
    ///   input: { resize: bilinear, antialias: false, size: [299, 299], range: [-1, 1] }
    /// ";
    /// let networks = Networks::parse(text, "networks.yaml")?;
    /// assert!(networks.spec(Role::Fid).is_some());
    /// assert_eq!(networks.absent().count(), 10);
    /// # Ok(())
    /// # }
    /// ```
    pub fn parse(text: &str, file: impl Into<PathBuf>) -> Result<Self> {
        let file = file.into();
        // An empty file, or one with comments only, is null: no network.
        let roles = match serde_yaml_ng::from_str::<Option<Roles>>(text) {
            Ok(roles) => roles.unwrap_or_default(),
            Err(reason) => return Err(Error::Yaml { file, reason }),
        };
        let mut specs = BTreeMap::new();
        for (role, spec) in roles.named() {
            let spec = spec.checked(role).map_err(|(key, reason)| Error::Key {
                file: file.clone(),
                role,
                key,
                reason,
            })?;
            specs.insert(role, spec);
        }
        Ok(Self { file, specs })
    }

    /// Path of `networks.yaml`.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Description of a role's network, with defaults; `None` if missing.
    pub fn spec(&self, role: Role) -> Option<&Spec> {
        self.specs.get(&role)
    }

    /// Roles with a network, in the order of [`Role::ALL`].
    pub fn present(&self) -> impl Iterator<Item = Role> {
        self.specs.keys().copied()
    }

    /// Roles without a network; see [`Role::not_measured`].
    pub fn absent(&self) -> impl Iterator<Item = Role> {
        let specs = &self.specs;
        Role::ALL
            .into_iter()
            .filter(|role| !specs.contains_key(role))
    }

    /// Opens a role's network: reads the file, verifies its SHA-256 if given, and loads it.
    pub fn open(&self, role: Role) -> Result<Network> {
        let spec = self.spec(role).ok_or_else(|| Error::MissingNetwork {
            role,
            file: self.file.clone(),
        })?;
        let folder = self.file.parent().unwrap_or(Path::new(""));
        Network::open(role, spec.clone(), &folder.join(&spec.file))
    }

    /// The network of `fid`, `subject`, `background`, or of `jepa` for pictures.
    pub fn features(&self, role: Role) -> Result<Features> {
        Features::new(self.open(role)?)
    }

    /// The network of `fvd`, or of `jepa` for clips.
    pub fn clip_features(&self, role: Role) -> Result<ClipFeatures> {
        ClipFeatures::new(self.open(role)?)
    }

    /// The network of `musiq` or `aesthetic`.
    pub fn scores(&self, role: Role) -> Result<Scores> {
        Scores::new(self.open(role)?)
    }

    /// The network of `lpips`.
    pub fn distance(&self) -> Result<Distance> {
        Distance::new(self.open(Role::Lpips)?)
    }

    /// The network of `flow`.
    pub fn flow(&self) -> Result<Flow> {
        Flow::new(self.open(Role::Flow)?)
    }

    /// The network of `depth`.
    pub fn depth(&self) -> Result<Depth> {
        Depth::new(self.open(Role::Depth)?)
    }

    /// The network of `tracks`.
    pub fn tracks(&self) -> Result<Tracks> {
        Tracks::new(self.open(Role::Tracks)?)
    }
}

impl Roles {
    fn named(self) -> impl Iterator<Item = (Role, Spec)> {
        [
            (Role::Lpips, self.lpips),
            (Role::Fid, self.fid),
            (Role::Fvd, self.fvd),
            (Role::Musiq, self.musiq),
            (Role::Aesthetic, self.aesthetic),
            (Role::Jepa, self.jepa),
            (Role::Subject, self.subject),
            (Role::Background, self.background),
            (Role::Flow, self.flow),
            (Role::Depth, self.depth),
            (Role::Tracks, self.tracks),
        ]
        .into_iter()
        .filter_map(|(role, spec)| Some((role, spec?)))
    }
}
