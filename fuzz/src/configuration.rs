//! Targets for configuration: launch files and parameter files.

use crate::scratch;
use std::{
    collections::BTreeMap,
    io,
    path::{Path, PathBuf},
};
use wm_launch::{LaunchFile, Plan, Surroundings};
use wm_ros::NodeArgs;

/// Parses and resolves a launch file; an include finds the same file again.
pub fn launch(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    let path = Path::new("fuzz.launch.yaml");
    let Ok(file) = LaunchFile::parse(path, text) else {
        return;
    };
    let _ = wm_launch::describe_arguments(&file);
    Plan::resolve(&file, &BTreeMap::new(), &SingleFile(text)).ok();
}

/// Reads a parameter file.
pub fn parameters(data: &[u8]) {
    let path = scratch::file("parameters", "parameters.yaml", data);
    let path = path.to_string_lossy().into_owned();
    NodeArgs::parse(["--ros-args".to_owned(), "--params-file".to_owned(), path]).ok();
}

/// Surroundings in which every path is the launch file.
struct SingleFile<'a>(&'a str);

impl Surroundings for SingleFile<'_> {
    fn environment(&self, name: &str) -> Option<String> {
        (name == "HOME").then(|| "/home/robot".to_owned())
    }

    fn read(&self, _: &Path) -> io::Result<String> {
        Ok(self.0.to_owned())
    }

    fn exists(&self, _: &Path) -> bool {
        true
    }

    fn package_prefix(&self, package: &str) -> Option<PathBuf> {
        Some(Path::new("/opt/ros").join(package))
    }
}
