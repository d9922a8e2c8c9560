//! The topics on offer, and their highest rates.

use crate::ViewError;
use std::time::Duration;
use wm_bag::TopicFilter;
use wm_ros::TopicInfo;

/// Allowed rates \[Hz\]. The lowest is one message a day, so that times do not overflow.
const RATES: std::ops::RangeInclusive<f64> = 1.0 / 86_400.0..=1e6;

#[derive(Debug)]
pub(crate) struct Offer {
    filter: TopicFilter,
    rates: Vec<(TopicFilter, Duration)>,
}

impl Offer {
    /// Topics whose name contains a match of `topics` and none of `exclude`, at the rates of `rates`: entries
    /// `EXPRESSION=HZ`, of which the first match counts. `None` if `topics` is empty.
    ///
    /// # Errors
    /// An invalid expression or entry.
    pub(crate) fn new(
        topics: &str,
        exclude: &str,
        rates: &[String],
    ) -> Result<Option<Self>, ViewError> {
        if topics.is_empty() {
            return Ok(None);
        }
        let exclude = Some(exclude).filter(|text| !text.is_empty());
        let filter = TopicFilter::new(Vec::new(), Some(topics), Vec::new(), exclude)?;
        let rate = |text: &String| {
            let (expression, hertz) = text
                .rsplit_once('=')
                .and_then(|(expression, hertz)| {
                    let hertz = hertz.trim().parse::<f64>().ok()?;
                    RATES.contains(&hertz).then_some((expression, hertz))
                })
                .ok_or_else(|| ViewError::Rate(text.clone()))?;
            let filter = TopicFilter::new(Vec::new(), Some(expression), Vec::new(), None)?;
            Ok((filter, Duration::from_secs_f64(1.0 / hertz)))
        };
        let rates = rates.iter().map(rate).collect::<Result<_, ViewError>>()?;
        Ok(Some(Self { filter, rates }))
    }

    /// Whether this topic is on offer now: selected, published and not hidden.
    pub(crate) fn has(&self, topic: &TopicInfo) -> bool {
        // a hidden topic has a part that begins with an underscore
        let is_hidden = topic.name.split('/').any(|part| part.starts_with('_'));
        !topic.publishers.is_empty() && !is_hidden && self.filter.wants(&topic.name)
    }

    /// The shortest time between messages of a topic, if limited.
    pub(crate) fn period(&self, topic: &str) -> Option<Duration> {
        let mut rates = self.rates.iter();
        let found = rates.find(|(filter, _)| filter.wants(topic));
        found.map(|(_, period)| *period)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_ros::Qos;

    fn topic(name: &str, publishers: Vec<Qos>) -> TopicInfo {
        TopicInfo {
            name: name.to_owned(),
            type_name: "std_msgs/msg/String".to_owned(),
            publishers,
            subscribers: 1,
        }
    }

    #[test]
    fn only_selected_published_visible_topics_are_offered() {
        let offer = Offer::new(".*", "^/secret/", &[]).unwrap().unwrap();
        let published = |name| topic(name, vec![Qos::reliable(1)]);
        assert!(offer.has(&published("/a")));
        assert!(!offer.has(&topic("/a", vec![])));
        assert!(!offer.has(&published("/a/_action/feedback")));
        assert!(!offer.has(&published("/secret/a")));
        assert!(Offer::new("", "", &[]).unwrap().is_none());
    }

    #[test]
    fn first_matching_rate_counts() {
        let rates = ["^/camera/=5".to_owned(), "image=0.5".to_owned()];
        let offer = Offer::new(".*", "", &rates).unwrap().unwrap();
        let period = |topic| offer.period(topic).map(|period| period.as_secs_f64());
        assert_eq!(period("/camera/image"), Some(0.2));
        assert_eq!(period("/wm/image"), Some(2.0));
        assert_eq!(period("/tf"), None);
    }

    #[test]
    fn invalid_rates_are_named() {
        for text in ["/a", "/a=", "/a=0", "/a=-1", "/a=NaN", "/a=1e-9"] {
            let error = Offer::new(".*", "", &[text.to_owned()]).unwrap_err();
            assert!(
                error.to_string().contains(&format!("\"{text}\"")),
                "{error}"
            );
        }
        for (topics, rates) in [("(", vec![]), (".*", vec!["(=1".to_owned()])] {
            let error = Offer::new(topics, "", &rates).unwrap_err().to_string();
            assert!(error.contains("regular expression"), "{error}");
        }
    }
}
