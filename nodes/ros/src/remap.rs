//! `-r`: rules that rename a node, its namespace, its topics and its services.

/// The target of a rule.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Target {
    /// `__node:=`, the node's base name.
    Node,
    /// `__ns:=`, the node's namespace.
    Namespace,
    /// A topic or service, unexpanded; expanded for comparison.
    Name(String),
}

/// One rule.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Remap {
    /// The rule applies only to the node of this base name.
    pub(crate) node: Option<String>,
    /// The old name.
    pub(crate) from: Target,
    /// The new name.
    pub(crate) to: String,
}

impl Remap {
    /// Parses `from:=to` or `node:from:=to`.
    pub(crate) fn parse(rule: &str) -> Result<Self, String> {
        let Some((from, to)) = rule.split_once(":=") else {
            return Err("from:=to".to_owned());
        };
        if from.contains("://") {
            return Err(
                "a name without a scheme (rosservice:// and rostopic:// are not supported)"
                    .to_owned(),
            );
        }
        let (node, from) = match from.split_once(':') {
            Some((node, from)) => (Some(node.to_owned()), from),
            None => (None, from),
        };
        if from.is_empty() || to.is_empty() || node.as_deref() == Some("") {
            return Err("names on both sides of :=".to_owned());
        }
        let from = match from {
            "__node" | "__name" => Target::Node,
            "__ns" => Target::Namespace,
            name => Target::Name(name.to_owned()),
        };
        Ok(Self {
            node,
            from,
            to: to.to_owned(),
        })
    }

    /// Whether the rule applies to a node of this base name.
    pub(crate) fn is_for(&self, node: &str) -> bool {
        self.node.as_deref().is_none_or(|only| only == node)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_forms_of_a_rule() {
        let rule = |node: Option<&str>, from, to: &str| Remap {
            node: node.map(str::to_owned),
            from,
            to: to.to_owned(),
        };
        assert_eq!(
            Remap::parse("__ns:=/arm").unwrap(),
            rule(None, Target::Namespace, "/arm")
        );
        assert_eq!(
            Remap::parse("enc:__node:=eye").unwrap(),
            rule(Some("enc"), Target::Node, "eye")
        );
        assert_eq!(
            Remap::parse("a:=/b").unwrap(),
            rule(None, Target::Name("a".into()), "/b")
        );
        assert!(Remap::parse("a=b").is_err());
        assert!(Remap::parse("a:=").is_err());
        assert!(Remap::parse(":a:=b").is_err());
        assert!(Remap::parse("rosservice://a:=b").is_err());
    }
}
