//! The options of `ros2 bag` that say which topics are meant.

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
