//! The options of `ros2 bag` that select topics.

use anyhow::Result;
use clap::Args;
use wm_bag::TopicFilter;

/// Which topics.
#[derive(Args, Debug)]
pub(super) struct TopicOptions {
    /// Select these topics; all topics if neither this option nor --regex is given
    #[arg(long, value_name = "TOPIC", num_args = 1..)]
    topics: Vec<String>,
    /// Also select topics whose name contains a match of this regular expression
    #[arg(short = 'e', long, value_name = "REGEX")]
    regex: Option<String>,
    /// Exclude these topics, even if they are selected
    #[arg(long, value_name = "TOPIC", num_args = 1..)]
    exclude_topics: Vec<String>,
    /// Exclude topics whose name contains a match of this regular expression
    #[arg(short = 'x', long, value_name = "REGEX")]
    exclude_regex: Option<String>,
}

impl TopicOptions {
    /// The selected topics.
    ///
    /// # Errors
    /// A text is not a regular expression.
    pub(super) fn filter(self) -> Result<TopicFilter> {
        Ok(TopicFilter::new(
            self.topics,
            self.regex.as_deref(),
            self.exclude_topics,
            self.exclude_regex.as_deref(),
        )?)
    }
}
