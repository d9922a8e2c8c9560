use regex::Regex;

use crate::BagError;

/// Selects topics as the options of `ros2 bag` do: named ones and those that match a regular expression (all without
/// either), except excluded ones.
#[derive(Clone, Debug, Default)]
pub struct TopicFilter {
    topics: Vec<String>,
    regex: Option<Regex>,
    exclude_topics: Vec<String>,
    exclude_regex: Option<Regex>,
}

impl TopicFilter {
    /// A filter of these names and expressions; an expression may match any part of a name.
    ///
    /// # Errors
    /// An expression is invalid.
    pub fn new(
        topics: Vec<String>,
        regex: Option<&str>,
        exclude_topics: Vec<String>,
        exclude_regex: Option<&str>,
    ) -> Result<Self, BagError> {
        let compiled = |text: &str| {
            Regex::new(text).map_err(|error| BagError::TopicRegex {
                text: text.to_owned(),
                reason: error.to_string(),
            })
        };
        Ok(Self {
            topics,
            regex: regex.map(compiled).transpose()?,
            exclude_topics,
            exclude_regex: exclude_regex.map(compiled).transpose()?,
        })
    }

    /// The named topics.
    #[must_use]
    pub fn named(&self) -> &[String] {
        &self.topics
    }

    /// Whether the filter has neither names nor an expression.
    #[must_use]
    pub fn is_all(&self) -> bool {
        self.topics.is_empty() && self.regex.is_none()
    }

    /// Whether this topic is excluded, even if it is named.
    #[must_use]
    pub fn excludes(&self, topic: &str) -> bool {
        let matches = |regex: &Option<Regex>| regex.as_ref().is_some_and(|r| r.is_match(topic));
        self.exclude_topics.iter().any(|name| name == topic) || matches(&self.exclude_regex)
    }

    /// Whether this topic is selected.
    #[must_use]
    pub fn wants(&self, topic: &str) -> bool {
        let is_named = self.topics.iter().any(|name| name == topic);
        let is_found = self.regex.as_ref().is_some_and(|r| r.is_match(topic));
        (self.is_all() || is_named || is_found) && !self.excludes(topic)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exclusion_wins_over_names_and_expressions() {
        let filter = |topics: &[&str], regex, exclude: &[&str], exclude_regex| {
            let owned = |names: &[&str]| names.iter().map(ToString::to_string).collect();
            TopicFilter::new(owned(topics), regex, owned(exclude), exclude_regex).unwrap()
        };
        let all = ["/a", "/a/b", "/c"];
        let wanted = |filter: TopicFilter| {
            all.into_iter()
                .filter(|topic| filter.wants(topic))
                .collect::<Vec<_>>()
        };
        assert_eq!(wanted(filter(&[], None, &[], None)), all);
        assert_eq!(
            wanted(filter(&["/c"], Some("^/a$"), &[], None)),
            ["/a", "/c"]
        );
        assert_eq!(wanted(filter(&["/a", "/c"], None, &["/c"], None)), ["/a"]);
        assert_eq!(wanted(filter(&[], None, &[], Some("/b"))), ["/a", "/c"]);
        let error = TopicFilter::new(vec![], Some("("), vec![], None)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("regular expression") && error.contains('('),
            "{error}"
        );
    }
}
