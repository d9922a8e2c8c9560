//! Converts ROS names to Zenoh key expressions in the format of the ros2dds bridge: `/wm/latent` becomes `wm/latent`,
//! and with the namespace `/robot1` `robot1/wm/latent`.

use std::str::FromStr;
use zenoh::key_expr::OwnedKeyExpr;

/// The prefix of this side's names on Zenoh.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Namespace {
    /// Without slashes at its ends; may be empty.
    prefix: String,
}

/// Why a text is not a namespace.
#[derive(Debug, thiserror::Error)]
#[error("`{0}` is not a namespace: expected / or /name/name, of letters, digits and _")]
pub(crate) struct NamespaceError(String);

impl FromStr for Namespace {
    type Err = NamespaceError;

    fn from_str(text: &str) -> Result<Self, NamespaceError> {
        let refused = || NamespaceError(text.to_owned());
        let prefix = text.strip_prefix('/').ok_or_else(refused)?;
        let is_part = |part: &str| {
            !part.is_empty() && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
        };
        if !prefix.is_empty() && !prefix.split('/').all(is_part) {
            return Err(refused());
        }
        Ok(Self {
            prefix: prefix.to_owned(),
        })
    }
}

impl Namespace {
    /// The key expression of an absolute ROS name; `None` if impossible.
    pub(crate) fn key_of(&self, name: &str) -> Option<OwnedKeyExpr> {
        let relative = name.strip_prefix('/')?;
        if relative.contains(['*', '$']) {
            return None;
        }
        let key = match self.prefix.as_str() {
            "" => relative.to_owned(),
            prefix => format!("{prefix}/{relative}"),
        };
        OwnedKeyExpr::new(key).ok()
    }

    /// The ROS name of a key, without the namespace if the key has it.
    pub(crate) fn name_of(&self, key: &str) -> String {
        let under = key
            .strip_prefix(self.prefix.as_str())
            .filter(|rest| !self.prefix.is_empty() && rest.starts_with('/'));
        under.map_or_else(|| format!("/{key}"), ToOwned::to_owned)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn namespace(text: &str) -> Namespace {
        text.parse().unwrap()
    }

    #[test]
    fn keys_have_the_namespace_and_no_leading_slash() {
        let key = |space: &str, name: &str| namespace(space).key_of(name).map(String::from);
        assert_eq!(key("/", "/wm/latent").as_deref(), Some("wm/latent"));
        assert_eq!(
            key("/robot1", "/wm/latent").as_deref(),
            Some("robot1/wm/latent")
        );
        assert_eq!(key("/", "relative"), None);
        assert_eq!(key("/", "/a/**"), None);
        assert_eq!(key("/", "/"), None);
    }

    #[test]
    fn only_whole_parts_are_the_namespace() {
        let robot = namespace("/robot1");
        assert_eq!(robot.name_of("robot1/wm/latent"), "/wm/latent");
        assert_eq!(robot.name_of("robot10/wm/latent"), "/robot10/wm/latent");
        assert_eq!(robot.name_of("robot1"), "/robot1");
    }

    #[test]
    fn invalid_namespaces_are_refused() {
        for text in ["", "robot", "/a//b", "/a/", "/a*", "/ä"] {
            assert!(text.parse::<Namespace>().is_err(), "{text}");
        }
    }

    proptest! {
        #[test]
        fn a_name_survives(space in "/|(/[a-z_][a-z0-9_]{0,5}){1,3}", name in "(/[a-z_][a-z0-9_]{0,5}){1,4}") {
            let namespace = namespace(&space);
            let key = namespace.key_of(&name).unwrap();
            prop_assert_eq!(namespace.name_of(&key), name);
        }
    }
}
