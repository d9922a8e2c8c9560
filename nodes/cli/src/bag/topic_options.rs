//! The options of `ros2 bag` that say which topics are meant.

use super::parameters::Parameters;
use anyhow::Result;
use clap::Args;
use wm_bag::TopicFilter;

/// Which topics.
#[derive(Args, Debug)]
pub struct TopicOptions {
    /// Keep these topics; all, where none is named here nor found by --regex
    #[arg(long, value_name = "TOPIC", num_args = 1..)]
    topics: Vec<String>,
    /// Keep the topics in whose name this regular expression is found, beside those of --topics
    #[arg(short = 'e', long, value_name = "REGEX")]
    regex: Option<String>,
    /// Leave these topics out, whatever keeps them
    #[arg(long, value_name = "TOPIC", num_args = 1..)]
    exclude_topics: Vec<String>,
    /// Leave the topics out in whose name this regular expression is found
    #[arg(short = 'x', long, value_name = "REGEX")]
    exclude_regex: Option<String>,
}

impl TopicOptions {
    /// Whether neither names nor an expression say which topics are meant.
    pub fn is_all(&self) -> bool {
        self.topics.is_empty() && self.regex.is_none()
    }

    /// Names these topics, too.
    pub fn add(&mut self, topics: Vec<String>) {
        self.topics.extend(topics);
    }

    /// As parameters of a node.
    pub fn parameters(&self, parameters: &mut Parameters) -> Result<()> {
        parameters.set_list("topics", &self.topics)?;
        parameters.set_list("exclude_topics", &self.exclude_topics)?;
        parameters.set_some("regex", self.regex.as_ref())?;
        parameters.set_some("exclude_regex", self.exclude_regex.as_ref())
    }

    /// The topics meant.
    ///
    /// # Errors
    /// Text that is no regular expression.
    pub fn filter(self) -> Result<TopicFilter> {
        Ok(TopicFilter::new(
            self.topics,
            self.regex.as_deref(),
            self.exclude_topics,
            self.exclude_regex.as_deref(),
        )?)
    }
}
