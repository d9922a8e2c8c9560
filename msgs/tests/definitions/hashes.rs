//! Compares our type hashes with a committed list, and with the hashes that the real rosidl computed.

use super::{DEFINITIONS, installation::Installation};
use std::collections::BTreeMap;
use wm_msgs::TypeDescription;

/// Every type of the crate, with the types that rosidl makes of its actions, and its hash.
fn ours() -> BTreeMap<String, String> {
    let mut hashes = BTreeMap::new();
    let mut add = |name: &str, description: TypeDescription| {
        hashes.insert(name.to_owned(), description.hash().to_string());
    };
    let given = || DEFINITIONS.iter().copied();
    for (name, text) in given() {
        if name.contains("/action/") {
            let action = TypeDescription::action(name, text, given()).unwrap();
            let parts = action.referenced.iter().map(|part| part.name.as_str());
            for part in parts.filter(|part| part.starts_with(name)) {
                add(part, TypeDescription::action(part, text, given()).unwrap());
            }
            add(name, action.clone());
        } else if name.contains("/srv/") {
            add(name, TypeDescription::service(name, text, given()).unwrap());
        } else {
            add(name, TypeDescription::message(name, text, given()).unwrap());
        }
    }
    hashes
}

#[test]
fn every_type_has_the_hash_of_the_committed_list() {
    let list = include_str!("type_hashes.txt").lines();
    let list = list.filter_map(|line| line.split_once(" RIHS01_"));
    let committed: BTreeMap<String, String> = list
        .map(|(name, hash)| (name.to_owned(), format!("RIHS01_{hash}")))
        .collect();
    assert_eq!(ours(), committed);
}

/// If a ROS installation is found, each type is compared with the output of its rosidl.
#[test]
fn hashes_are_those_of_the_ros_installation() {
    let Some(installation) = Installation::find() else {
        return;
    };
    let mut compared = Vec::new();
    let ours = ours();
    for (name, hash) in &ours {
        // the types that rosidl makes of an action are in the action's file
        let file = match name.split_once("/action/") {
            Some((package, part)) => {
                format!("{package}/action/{}", part.split('_').next().unwrap())
            }
            None => name.clone(),
        };
        let Some(text) = installation.read(&file, "json") else {
            continue;
        };
        let file: serde_json::Value = serde_json::from_str(&text).unwrap();
        let theirs = file["type_hashes"]
            .as_array()
            .unwrap()
            .iter()
            .find(|entry| entry["type_name"] == name.as_str())
            .unwrap();
        assert_eq!(theirs["hash_string"], hash.as_str(), "{name}");
        compared.push(name);
    }
    eprintln!(
        "{} of {} hashes are equal to those of the installation",
        compared.len(),
        ours.len()
    );
    assert!(!compared.is_empty(), "it has none of our types");
    if std::env::var_os("CI").is_some() {
        let of_package = |name: &&String| name.starts_with("wm_msgs/");
        assert_eq!(
            compared.into_iter().filter(of_package).count(),
            ours.keys().filter(of_package).count(),
            "in CI, the real rosidl builds all of wm_msgs"
        );
    }
}
