//! Names of nodes, topics, services and types: their rules, and the resolution of relative names.
//!
//! The rules: <https://design.ros2.org/articles/topic_and_service_names.html>.

use crate::{
    Error,
    remap::{Remap, Target},
};
use std::fmt;
use wm_msgs::Action;

/// A node's name and namespace after remapping, and the rules that hold for its topics and services.
#[derive(Clone, Debug)]
pub(crate) struct NodeName {
    /// `/wm`, or `/` for none.
    pub(crate) namespace: String,
    /// `encoder`.
    pub(crate) base: String,
    /// `/wm/encoder`.
    pub(crate) fully_qualified: String,
    /// `(expanded from, to)` in the order of the command line.
    rules: Vec<(String, String)>,
}

impl NodeName {
    /// Applies `__node` and `__ns`, then expands the other rules.
    pub(crate) fn new(
        default_base: &str,
        default_namespace: &str,
        remaps: &[Remap],
    ) -> Result<Self, Error> {
        let first = |target: &Target| {
            let is_match = |remap: &&Remap| remap.from == *target && remap.is_for(default_base);
            remaps.iter().find(is_match).map(|remap| remap.to.as_str())
        };
        let base = first(&Target::Node).unwrap_or(default_base).to_owned();
        let namespace = first(&Target::Namespace).unwrap_or(default_namespace);
        let namespace = match namespace.trim_start_matches('/') {
            "" => "/".to_owned(),
            relative => format!("/{relative}"),
        };
        check_part(&base, "node", &base)?;
        if namespace != "/" {
            check_absolute(&namespace, "namespace")?;
        }
        let fully_qualified = join(&namespace, &base);
        let mut name = Self {
            namespace,
            base,
            fully_qualified,
            rules: Vec::new(),
        };
        for remap in remaps.iter().filter(|remap| remap.is_for(&name.base)) {
            if let Target::Name(from) = &remap.from {
                let rule = (
                    name.expand(from, "remapping")?,
                    name.expand(&remap.to, "remapping")?,
                );
                name.rules.push(rule);
            }
        }
        Ok(name)
    }

    /// The absolute name of a topic or service, remapping applied.
    pub(crate) fn resolve(&self, name: &str, kind: &'static str) -> Result<String, Error> {
        let expanded = self.expand(name, kind)?;
        let rule = self.rules.iter().find(|(from, _)| *from == expanded);
        Ok(rule.map_or(expanded, |(_, to)| to.clone()))
    }

    /// The name of `name`'s sibling `name/suffix`: by its own rule, or the sibling of the remapped `name`. A `name`
    /// that is itself remapped to such a sibling, for example `/front/image_raw/compressed`, is refused.
    pub(crate) fn resolve_sibling(
        &self,
        name: &str,
        suffix: &str,
        kind: &'static str,
    ) -> Result<String, Error> {
        let base = self.resolve(name, kind)?;
        let end = format!("/{suffix}");
        if let Some(wanted) = base.strip_suffix(&end).filter(|rest| !rest.is_empty()) {
            let reason = format!(
                "give the topic that it belongs to, {wanted}: its sibling {end} is used too"
            );
            return Err(invalid(&base, kind, &reason));
        }
        let sibling = self.expand(&format!("{name}{end}"), kind)?;
        let rule = self.rules.iter().find(|(from, _)| *from == sibling);
        Ok(rule.map_or_else(|| base + &end, |(_, to)| to.clone()))
    }

    /// `~` and relative names made absolute.
    fn expand(&self, name: &str, kind: &'static str) -> Result<String, Error> {
        let absolute = if let Some(private) = name.strip_prefix("~/") {
            join(&self.fully_qualified, private)
        } else if name.starts_with('/') {
            name.to_owned()
        } else {
            join(&self.namespace, name)
        };
        check_absolute(&absolute, kind)?;
        Ok(absolute)
    }

    /// The name that log records carry: `wm.encoder`.
    pub(crate) fn logger(&self) -> String {
        self.fully_qualified
            .trim_start_matches('/')
            .replace('/', ".")
    }
}

fn join(namespace: &str, name: &str) -> String {
    format!("{}/{name}", namespace.trim_end_matches('/'))
}

fn check_absolute(name: &str, kind: &'static str) -> Result<(), Error> {
    name.trim_start_matches('/')
        .split('/')
        .try_for_each(|part| check_part(part, kind, name))?;
    match name.starts_with("//") {
        true => Err(invalid(name, kind, "two slashes in a row")),
        false => Ok(()),
    }
}

fn check_part(part: &str, kind: &'static str, name: &str) -> Result<(), Error> {
    let Some(first) = part.chars().next() else {
        return Err(invalid(name, kind, "a part is empty"));
    };
    if first.is_ascii_digit() {
        return Err(invalid(name, kind, "a part begins with a digit"));
    }
    if let Some(bad) = part
        .chars()
        .find(|c| !c.is_ascii_alphanumeric() && *c != '_')
    {
        return Err(invalid(
            name,
            kind,
            &format!("the character {bad:?}; letters, digits and _ are allowed"),
        ));
    }
    if part.contains("__") {
        return Err(invalid(name, kind, "two underscores in a row"));
    }
    Ok(())
}

fn invalid(name: &str, kind: &'static str, reason: &str) -> Error {
    Error::Name {
        name: name.to_owned(),
        kind,
        reason: reason.to_owned(),
    }
}

/// The parts of a type's ROS name, `package/kind/Type`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct TypeName {
    pub(crate) package: String,
    pub(crate) kind: TypeKind,
    pub(crate) name: String,
}

/// The kind of the type's definition. The types that rosidl generates for an action have the kind of the action: the
/// message `package/action/Type_FeedbackMessage`, the services `package/action/Type_SendGoal` and `_GetResult`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TypeKind {
    Message,
    Service,
    Action,
}

impl TypeKind {
    const ALL: [Self; 3] = [Self::Message, Self::Service, Self::Action];

    /// As in names of types and of files.
    pub(crate) const fn text(self) -> &'static str {
        match self {
            Self::Message => "msg",
            Self::Service => "srv",
            Self::Action => "action",
        }
    }

    pub(crate) fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.text() == text)
    }
}

impl fmt::Display for TypeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{}", self.package, self.kind.text(), self.name)
    }
}

impl TypeName {
    pub(crate) fn message(package: &str, name: &str) -> Self {
        Self::new(package, TypeKind::Message, name)
    }

    pub(crate) fn service(package: &str, name: &str) -> Self {
        Self::new(package, TypeKind::Service, name)
    }

    /// A type that rosidl generates for an action, `SendGoal` for example.
    pub(crate) fn of_action<A: Action>(part: &str) -> Self {
        Self::new(A::PACKAGE, TypeKind::Action, &format!("{}_{part}", A::NAME))
    }

    fn new(package: &str, kind: TypeKind, name: &str) -> Self {
        Self {
            package: package.to_owned(),
            kind,
            name: name.to_owned(),
        }
    }

    /// Parses the type of a topic, `package/msg/Type` or a message of an action; also accepts `package/Type`.
    pub(crate) fn parse_message(text: &str) -> Result<Self, Error> {
        Self::parse(text, TypeKind::Message)
    }

    /// Parses the type of a service, `package/srv/Type` or a service of an action; also accepts `package/Type`.
    pub(crate) fn parse_service(text: &str) -> Result<Self, Error> {
        Self::parse(text, TypeKind::Service)
    }

    fn parse(text: &str, expected: TypeKind) -> Result<Self, Error> {
        let parts: Vec<_> = text.split('/').collect();
        let (package, kind, name) = match parts[..] {
            [package, name] => (package, Some(expected), name),
            [package, kind, name] => (package, TypeKind::parse(kind), name),
            _ => ("", None, ""),
        };
        let kind = kind.filter(|kind| *kind == expected || *kind == TypeKind::Action);
        let kind = kind.ok_or_else(|| {
            let reason = format!("expected package/{}/Type", expected.text());
            invalid(text, "type", &reason)
        })?;
        check_part(package, "type", text)?;
        check_part(name, "type", text)?;
        Ok(Self::new(package, kind, name))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NodeArgs;
    use proptest::prelude::*;

    fn node(line: &str) -> Result<NodeName, Error> {
        let args = NodeArgs::parse(line.split_whitespace())?;
        NodeName::new("encoder", "/wm", &args.remaps)
    }

    #[test]
    fn relative_names_stand_under_the_namespace() {
        let name = node("").unwrap();
        assert_eq!(name.fully_qualified, "/wm/encoder");
        assert_eq!(name.logger(), "wm.encoder");
        assert_eq!(name.resolve("latent", "topic").unwrap(), "/wm/latent");
        assert_eq!(
            name.resolve("/camera/image_raw", "topic").unwrap(),
            "/camera/image_raw"
        );
        assert_eq!(
            name.resolve("~/reset", "service").unwrap(),
            "/wm/encoder/reset"
        );
    }

    #[test]
    fn the_namespace_and_the_name_can_be_replaced() {
        let name = node("--ros-args -r __ns:=/robot1/wm -r __node:=eye").unwrap();
        assert_eq!(name.fully_qualified, "/robot1/wm/eye");
        assert_eq!(
            name.resolve("latent", "topic").unwrap(),
            "/robot1/wm/latent"
        );
        assert_eq!(
            node("--ros-args -r __ns:=/")
                .unwrap()
                .resolve("latent", "topic")
                .unwrap(),
            "/latent"
        );
    }

    #[test]
    fn first_matching_rule_applies_and_other_nodes_rules_do_not() {
        let name =
            node("--ros-args -r decoder:latent:=/no -r latent:=/a -r /wm/latent:=/b -r /x:=y")
                .unwrap();
        assert_eq!(name.resolve("latent", "topic").unwrap(), "/a");
        assert_eq!(name.resolve("/x", "topic").unwrap(), "/wm/y");
        assert_eq!(name.resolve("/a", "topic").unwrap(), "/a");
    }

    #[test]
    fn sibling_follows_its_topic_unless_it_has_its_own_rule() {
        let compressed = |line: &str| {
            let name = node(line).unwrap();
            name.resolve_sibling("/camera/image_raw", "compressed", "topic")
                .unwrap()
        };
        assert_eq!(compressed(""), "/camera/image_raw/compressed");
        let with = "--ros-args -r /camera/image_raw:=/front/image_raw";
        assert_eq!(compressed(with), "/front/image_raw/compressed");
        let apart = format!("{with} -r /camera/image_raw/compressed:=/jpeg");
        assert_eq!(compressed(&apart), "/jpeg");
    }

    #[test]
    fn a_sibling_is_not_taken_for_its_topic() {
        let to = "/front/image_raw/compressed";
        for line in [
            format!("--ros-args -r /camera/image_raw:={to}"),
            // As in a launch file that remaps both.
            format!(
                "--ros-args -r /camera/image_raw:={to} -r /camera/image_raw/compressed:={to}/compressed"
            ),
        ] {
            let name = node(&line).unwrap();
            let error = name.resolve_sibling("/camera/image_raw", "compressed", "topic");
            let error = error.unwrap_err().to_string();
            assert!(error.contains("belongs to, /front/image_raw:"), "{error}");
        }
    }

    #[test]
    fn names_that_ros_forbids_are_refused_with_the_rule() {
        let reason = |name: &str| {
            node("")
                .unwrap()
                .resolve(name, "topic")
                .unwrap_err()
                .to_string()
        };
        assert!(reason("a//b").contains("empty"));
        assert!(reason("//a").contains("slashes") || reason("//a").contains("empty"));
        assert!(reason("2a").contains("digit"));
        assert!(reason("a-b").contains("'-'"));
        assert!(reason("a__b").contains("underscores"));
        assert!(reason("").contains("empty"));
        assert!(node("--ros-args -r __node:=a/b").is_err());
    }

    #[test]
    fn types_come_in_both_spellings() {
        let string = TypeName::message("std_msgs", "String");
        assert_eq!(
            TypeName::parse_message("std_msgs/msg/String").unwrap(),
            string
        );
        assert_eq!(TypeName::parse_message("std_msgs/String").unwrap(), string);
        assert!(TypeName::parse_message("String").is_err());
        assert!(TypeName::parse_message("std_msgs/srv/String").is_err());
        assert!(TypeName::parse_service("std_msgs/srv/String").is_ok());
        assert!(TypeName::parse_service("std_msgs/msg/String").is_err());
        let feedback = TypeName::of_action::<wm_msgs::wm_msgs::action::Plan>("FeedbackMessage");
        let name = "wm_msgs/action/Plan_FeedbackMessage";
        assert_eq!(feedback.to_string(), name);
        assert_eq!(TypeName::parse_message(name).unwrap(), feedback);
        assert!(TypeName::parse_service("wm_msgs/action/Plan_SendGoal").is_ok());
        assert!(TypeName::parse_service("wm_msgs/act/Plan_SendGoal").is_err());
    }

    proptest! {
        /// Resolved names are absolute and pass the rules again.
        #[test]
        fn a_resolved_name_is_absolute_and_stays(name in "[a-z_/~0-9]{0,12}") {
            let node = node("").unwrap();
            if let Ok(resolved) = node.resolve(&name, "topic") {
                prop_assert!(resolved.starts_with('/'));
                prop_assert_eq!(node.resolve(&resolved, "topic").unwrap(), resolved);
            }
        }
    }
}
