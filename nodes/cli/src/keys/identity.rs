//! An identity: the owner of a certificate, and its rights.

use anyhow::{Result, bail, ensure};
use std::collections::{BTreeMap, BTreeSet};
use wm_ros::{GraphEndpoint, GraphNode, Role};

/// The owner of a certificate: a process with its nodes, or a tool.
#[derive(Clone, Debug)]
pub(super) struct Identity {
    /// The common name of its certificate: the full name of its node, for most.
    pub(super) name: String,
    /// The full names of its nodes; `None`: its nodes have any name, but no endpoints beyond these.
    pub(super) nodes: Option<Vec<String>>,
    /// Its endpoints. In their names, `*` stands for one part and `**` for any number of parts.
    pub(super) endpoints: BTreeSet<GraphEndpoint>,
    /// Whether its topics are missing, because only its bag names them.
    pub(super) lacks_topics: bool,
}

impl Identity {
    /// Of these nodes of one process.
    pub(super) fn new(name: String, nodes: Vec<GraphNode>) -> Self {
        let mut identity = Self {
            name,
            nodes: Some(nodes.iter().map(|node| node.name.clone()).collect()),
            endpoints: BTreeSet::new(),
            lacks_topics: false,
        };
        for node in nodes {
            identity.endpoints.extend(node.endpoints);
        }
        identity
    }

    /// The names with this role.
    pub(super) fn names(&self, role: Role) -> impl Iterator<Item = &str> {
        let endpoints = self.endpoints.iter();
        let of_role = endpoints.filter(move |endpoint| endpoint.role == role);
        of_role.map(|endpoint| &*endpoint.name)
    }

    /// A hint for the user.
    pub(super) fn note(&self) -> Option<String> {
        let name = &self.name;
        self.lacks_topics.then(|| {
            format!(
                "{name} may publish none of its bag's topics: give its bag (--ros-args -p {}:bag:=BAG), or name them \
                 (--node {name}=publish:/camera/image_raw)",
                name.rsplit('/').next().unwrap_or(name)
            )
        })
    }
}

/// The session file of this identity: `/wm/encoder` has `wm.encoder.json5`.
pub(super) fn file_of(identity: &str) -> String {
    let stem = identity.trim_start_matches('/').replace('/', ".");
    format!("{stem}.json5")
}

/// Refuses two identities with the same file, and names that are none of a file.
pub(super) fn check_distinct(identities: &[Identity]) -> Result<()> {
    let mut files = BTreeMap::from([(file_of("router"), "router")]);
    for identity in identities {
        let name = &*identity.name;
        check_name(name)?;
        if let Some(other) = files.insert(file_of(name), name) {
            ensure!(other != name, "{name} is given twice");
            bail!("{other} and {name} would have the same file");
        }
    }
    Ok(())
}

/// A common name, which is in file names and in the router's log.
pub(super) fn check_name(name: &str) -> Result<()> {
    let is_valid = |c: char| c.is_ascii_alphanumeric() || "_-./".contains(c);
    let first = name.trim_start_matches('/').chars().next();
    ensure!(
        name.chars().all(is_valid) && first.is_some_and(|c| c.is_ascii_alphanumeric() || c == '_'),
        "`{name}`: expected a name of letters, digits, _, -, . and /"
    );
    // rcgen and OpenSSL: the upper bound of a common name
    ensure!(
        name.len() <= 64,
        "`{name}`: expected a name of at most 64 bytes, which is the limit of certificates"
    );
    Ok(())
}
