//! `wm init`: generates a launch file and parameter files for the cameras and arms found.

use crate::{ModelFacts, Survey};
use std::fs::{self, OpenOptions};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use thiserror::Error;
use wm_ros::logging::of_others;

/// The template: the repository's launch file.
const LAUNCH: &str = include_str!("../../../launch-configs/live.launch.yaml");
const LAUNCH_NAME: &str = "live.launch.yaml";
/// Name and text of its parameter files, as the nodes print them.
const CONFIGS: [(&str, &str); 10] = [
    (
        "views",
        include_str!("../../../launch-configs/config/views.yaml"),
    ),
    (
        "encoder",
        include_str!("../../../launch-configs/config/encoder.yaml"),
    ),
    (
        "predictor",
        include_str!("../../../launch-configs/config/predictor.yaml"),
    ),
    (
        "decoder",
        include_str!("../../../launch-configs/config/decoder.yaml"),
    ),
    (
        "planner",
        include_str!("../../../launch-configs/config/planner.yaml"),
    ),
    (
        "evaluator",
        include_str!("../../../launch-configs/config/evaluator.yaml"),
    ),
    (
        "learner",
        include_str!("../../../launch-configs/config/learner.yaml"),
    ),
    (
        "recorder",
        include_str!("../../../launch-configs/config/recorder.yaml"),
    ),
    (
        "monitor",
        include_str!("../../../launch-configs/config/monitor.yaml"),
    ),
    (
        "view",
        include_str!("../../../launch-configs/config/view.yaml"),
    ),
];
/// The adapter's parameter file.
const ADAPTER: &str = include_str!("../../../launch-configs/config/action_adapter.yaml");
/// Values of the launch files that differ from defaults.
const JOBS: &str = include_str!("../../../launch-configs/config/jobs.yaml");
/// A parameter of several nodes.
const FRAME_PERIOD: &str = "frame_period";
/// The topic on which the adapter publishes.
const ADAPTED: &str = "/wm/action";

/// Why nothing was generated.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages explain variants and fields")]
#[non_exhaustive]
pub enum SetupError {
    #[error(
        "no camera was found: start its driver, or name its topic with --camera \
         (`wm doctor` says more)"
    )]
    NoCamera,
    #[error("several cameras were found: {}; choose one with --camera", .0.join(", "))]
    SeveralCameras(Vec<String>),
    #[error("several topics of actions were found: {}; choose one with --action", .0.join(", "))]
    SeveralActions(Vec<String>),
    /// A name that would have another meaning in a launch file.
    #[error(
        "the name of the {what}, `{text}`, contains a `$`, which has another meaning in a launch file"
    )]
    Substitution {
        /// The kind of name.
        what: &'static str,
        text: String,
    },
    /// A file exists already; nothing was written.
    #[error("{} exists already, and nothing was written: name another folder", .0.display())]
    Exists(PathBuf),
    #[error("cannot write {}", file.display())]
    Write { file: PathBuf, source: io::Error },
    /// The repository's launch file has changed, but this module has not.
    #[error("the bundled {file} has no {wanted}; please report this")]
    Template {
        file: &'static str,
        /// The text that is missing.
        wanted: String,
    },
}

impl SetupError {
    /// Whether the user has to give more or other arguments.
    #[must_use]
    pub fn is_usage(&self) -> bool {
        matches!(
            self,
            Self::SeveralCameras(_) | Self::SeveralActions(_) | Self::Substitution { .. }
        )
    }
}

/// The values of the generated files.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// Image topic of the camera.
    pub camera: String,
    /// Topic of the actions, or the topic that the adapter converts.
    pub action: String,
    /// The adapter's `source`; `None` if the arm publishes actions.
    pub adapter: Option<&'static str>,
    /// `tiny`, or a model folder.
    pub model: String,
    /// `frame_period` of the nodes if the camera is slower than the model \[s\].
    pub frame_period_s: Option<f64>,
}

impl Setup {
    /// From the topics found and the topics that the user named. Named topics may be missing.
    ///
    /// # Errors
    /// There is no choice or more than one.
    pub fn new(
        survey: &Survey,
        model: &ModelFacts,
        (camera, action): (Option<&str>, Option<&str>),
    ) -> Result<Self, SetupError> {
        let cameras: Vec<&String> = survey.cameras.keys().collect();
        let camera_name = match (camera, cameras.as_slice()) {
            (Some(name), _) => name.to_owned(),
            (None, []) => return Err(SetupError::NoCamera),
            (None, [only]) => (*only).clone(),
            (None, _) => return Err(SetupError::SeveralCameras(listed(&cameras))),
        };
        let taken = survey
            .actions
            .iter()
            .filter(|(_, actions)| !actions.is_chunk);
        let topics: Vec<&String> = taken.map(|(name, _)| name).collect();
        let (action, adapter) = match (action, topics.as_slice()) {
            (Some(name), _) => {
                let adapter = survey.motion(name).map(|motion| motion.source);
                (name.to_owned(), adapter)
            }
            // the nodes' default, for an arm that is not running yet
            (None, []) => (ADAPTED.to_owned(), None),
            (None, [only]) => ((*only).clone(), None),
            (None, _) => return Err(SetupError::SeveralActions(listed(&topics))),
        };
        let stream = survey
            .cameras
            .get(&camera_name)
            .and_then(crate::Camera::best);
        let camera_s = stream.and_then(|stream| stream.timeline.picture_period_s());
        Ok(Self {
            camera: camera_name,
            action,
            adapter,
            model: model.name.clone(),
            frame_period_s: camera_s.and_then(|camera_s| model.frame_period_s(camera_s)),
        })
    }

    /// Name within the folder and text of each file.
    ///
    /// # Errors
    /// A name cannot stand in a launch file.
    pub fn files(&self) -> Result<Vec<(PathBuf, String)>, SetupError> {
        let names = [
            ("camera", &self.camera),
            ("action", &self.action),
            ("model", &self.model),
        ];
        if let Some((what, text)) = names.into_iter().find(|(_, text)| text.contains('$')) {
            let text = text.clone();
            return Err(SetupError::Substitution { what, text });
        }
        let mut files = vec![(PathBuf::from(LAUNCH_NAME), self.launch()?)];
        for (name, text) in CONFIGS {
            files.push((config(name), self.parameters(text)));
        }
        files.push((config("jobs"), JOBS.to_owned()));
        if let Some(source) = self.adapter {
            let text = self.parameters(ADAPTER);
            files.push((
                config("action_adapter"),
                with_parameter(&text, "source", source),
            ));
        }
        Ok(files)
    }

    fn launch(&self) -> Result<String, SetupError> {
        // the nodes take the adapter's actions
        let action = match self.adapter {
            Some(_) => ADAPTED,
            None => &self.action,
        };
        let mut text = with_default(LAUNCH, "camera", &self.camera)?;
        text = with_default(&text, "action", action)?;
        text = with_default(&text, "model", &self.model)?;
        if let Some(source) = self.adapter {
            let from = match source {
                "twist" => "/wm/twist",
                "pose" => "/wm/ee_pose",
                _ => "/tf",
            };
            let to = quoted(&self.action);
            text.push_str(&format!(
                "- node:\n    pkg: wm_nodes\n    exec: action_adapter\n    name: action_adapter\n    output: screen\n    \
                 respawn: \"true\"\n    respawn_delay: 0.5\n    param:\n    - from: \"$(dirname)/config/action_adapter.yaml\"\n    \
                 remap:\n    - {{from: {from}, to: {to}}}\n"
            ));
        }
        Ok(text)
    }

    fn parameters(&self, text: &str) -> String {
        match self.frame_period_s {
            None => text.to_owned(),
            Some(period_s) => with_parameter(text, FRAME_PERIOD, &format!("{period_s:.4}")),
        }
    }

    /// Writes the files into `folder`, which is created if missing, and returns their paths.
    ///
    /// # Errors
    /// One of the files exists already (then none is written), or cannot be written.
    pub fn write(&self, folder: &Path) -> Result<Vec<PathBuf>, SetupError> {
        let files = self.files()?;
        let paths: Vec<PathBuf> = files.iter().map(|(name, _)| folder.join(name)).collect();
        if let Some(there) = paths.iter().find(|path| path.symlink_metadata().is_ok()) {
            return Err(SetupError::Exists(there.clone()));
        }
        for (path, (_, text)) in paths.iter().zip(&files) {
            let failed = |source| SetupError::Write {
                file: path.clone(),
                source,
            };
            if let Some(parent) = path.parent() {
                fs::create_dir_all(parent).map_err(failed)?;
            }
            let mut file = OpenOptions::new()
                .write(true)
                .create_new(true)
                .open(path)
                .map_err(failed)?;
            file.write_all(text.as_bytes()).map_err(failed)?;
        }
        Ok(paths)
    }
}

fn listed(names: &[&String]) -> Vec<String> {
    names.iter().map(|name| of_others(name)).collect()
}

fn config(name: &str) -> PathBuf {
    PathBuf::from(format!("config/{name}.yaml"))
}

/// JSON strings are valid YAML.
fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

/// The launch file with another default of the argument `name`.
fn with_default(text: &str, name: &str, default: &str) -> Result<String, SetupError> {
    let head = format!("    name: {name}\n    default: ");
    let absent = || SetupError::Template {
        file: LAUNCH_NAME,
        wanted: format!("argument {name} with a default"),
    };
    let (before, after) = text.split_once(&head).ok_or_else(absent)?;
    let (_, rest) = after.split_once('\n').ok_or_else(absent)?;
    Ok(format!("{before}{head}{}\n{rest}", quoted(default)))
}

/// The parameter file with another value of the parameter `name`, if it has one.
fn with_parameter(text: &str, name: &str, value: &str) -> String {
    let key = format!("    {name}: ");
    let line = |line: &str| match line.starts_with(&key) {
        true => format!("{key}{value}\n"),
        false => format!("{line}\n"),
    };
    text.lines().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Actions, Camera, Motion, Stream, fit::facts, timeline::regular};
    use std::collections::BTreeMap;
    use wm_launch::{Plan, System};

    fn survey() -> Survey {
        let mut survey = Survey::default();
        let stream = Stream {
            timeline: regular(9, 500, 10),
            ..Stream::default()
        };
        let camera = Camera {
            raw: Some(stream),
            ..Camera::default()
        };
        survey.cameras.insert("/front/image_raw".into(), camera);
        survey
            .actions
            .insert("/arm/action".into(), Actions::default());
        survey
    }

    /// The command lines that `wm launch` would run.
    fn plan(setup: &Setup) -> String {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("robot");
        let paths = setup.write(&target).unwrap();
        let file = wm_launch::read(&paths[0], &System).unwrap();
        let plan = Plan::resolve(&file, &BTreeMap::new(), &System).unwrap();
        assert_eq!(plan.warnings, Vec::<String>::new());
        for process in &plan.processes {
            for word in process
                .arguments
                .iter()
                .filter(|word| word.ends_with(".yaml"))
            {
                let text =
                    std::fs::read_to_string(word).unwrap_or_else(|error| panic!("{word}: {error}"));
                assert!(!text.is_empty());
            }
        }
        let lines = plan
            .processes
            .iter()
            .map(|process| format!("{} {}\n", process.name, process.arguments.join(" ")));
        lines.collect()
    }

    #[test]
    fn launch_file_is_valid_and_names_the_topics() {
        let setup = Setup::new(&survey(), &facts(), (None, None)).unwrap();
        assert_eq!(
            (setup.camera.as_str(), setup.action.as_str()),
            ("/front/image_raw", "/arm/action")
        );
        let plan = plan(&setup);
        for part in [
            "/camera/image_raw:=/front/image_raw",
            "/camera/image_raw/compressed:=/front/image_raw/compressed",
            "/wm/action:=/arm/action",
        ] {
            assert!(plan.contains(part), "{part} is missing:\n{plan}");
        }
        assert!(!plan.contains("action_adapter"));
    }

    #[test]
    fn every_parameter_file_that_the_launch_names_is_written() {
        let setup = Setup::new(&survey(), &facts(), (None, None)).unwrap();
        let files: BTreeMap<_, _> = setup.files().unwrap().into_iter().collect();
        let launch = &files[Path::new(LAUNCH_NAME)];
        let named = launch.split("$(dirname)/").skip(1);
        let named: Vec<_> = named.filter_map(|rest| rest.split('"').next()).collect();
        assert!(named.len() >= CONFIGS.len(), "{named:?}");
        for name in named {
            assert!(files.contains_key(Path::new(name)), "{name}");
        }
    }

    #[test]
    fn parameter_files_contain_a_slow_cameras_period() {
        let setup = Setup::new(&survey(), &facts(), (None, None)).unwrap();
        let files: BTreeMap<_, _> = setup.files().unwrap().into_iter().collect();
        for name in ["encoder", "predictor", "planner", "evaluator"] {
            let text = &files[&config(name)];
            assert!(text.contains("\n    frame_period: 0.5000\n"), "{name}");
            assert_eq!(text.matches("frame_period: ").count(), 1, "{name}");
        }
        let usual = Setup {
            frame_period_s: None,
            ..setup
        };
        for (name, original) in CONFIGS {
            let files = usual.files().unwrap();
            assert!(files.contains(&(config(name), original.to_owned())));
        }
    }

    #[test]
    fn arm_velocities_go_through_the_adapter() {
        let mut survey = survey();
        survey.motions.push(Motion {
            topic: "/arm/twist".into(),
            type_name: "geometry_msgs/msg/TwistStamped".into(),
            source: "twist",
        });
        let setup = Setup::new(&survey, &facts(), (None, Some("/arm/twist"))).unwrap();
        let plan = plan(&setup);
        assert!(
            plan.contains("/wm/twist:=/arm/twist") && !plan.contains("/wm/action:=/arm"),
            "{plan}"
        );
        let files: BTreeMap<_, _> = setup.files().unwrap().into_iter().collect();
        assert!(files[&config("action_adapter")].contains("\n    source: twist\n"));
    }

    #[test]
    fn existing_files_and_ambiguous_topics_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        let setup = Setup::new(&survey(), &facts(), (None, None)).unwrap();
        std::fs::create_dir(folder.path().join("config")).unwrap();
        let own = folder.path().join("config/monitor.yaml");
        std::fs::write(&own, "mine").unwrap();
        assert!(matches!(setup.write(folder.path()), Err(SetupError::Exists(path)) if path == own));
        assert_eq!(std::fs::read_to_string(&own).unwrap(), "mine");
        assert!(!folder.path().join(LAUNCH_NAME).exists());

        let new = |survey: &Survey, camera| Setup::new(survey, &facts(), (camera, None));
        assert!(matches!(
            new(&Survey::default(), None),
            Err(SetupError::NoCamera)
        ));
        assert_eq!(
            new(&Survey::default(), Some("/c")).unwrap().action,
            "/wm/action"
        );
        let mut two = survey();
        two.cameras.insert("/wrist".into(), Camera::default());
        assert!(new(&two, None).unwrap_err().is_usage());
        assert_eq!(new(&two, Some("/wrist")).unwrap().camera, "/wrist");
    }

    #[test]
    fn names_with_launch_substitutions_are_refused() {
        let mut setup = Setup::new(&survey(), &facts(), (None, None)).unwrap();
        setup.model = "/models/\"quoted\" and 5".into();
        let plan = plan(&setup);
        assert!(plan.contains("quoted"), "{plan}");
        for model in ["$(env HOME)", "/models/$5"] {
            setup.model = model.into();
            let files = setup.files();
            assert!(
                matches!(files, Err(SetupError::Substitution { .. })),
                "{model}"
            );
        }
    }
}
