//! The messages of the protocol, as much of them as is needed to look.

use bytes::{BufMut as _, Bytes, BytesMut};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The encoding of messages: CDR with its header of four bytes.
const ENCODING: &str = "cdr";
/// The encoding of definitions: `.msg` text with all that it names.
pub const SCHEMA_ENCODING: &str = "ros2msg";
/// By this a viewer knows that it is ROS 2. Types that a definition does not define come from it; ours define all.
const DISTRIBUTION: &str = "kilted";
/// The operation of a binary message with data.
const MESSAGE_DATA: u8 = 1;
/// Operation, subscription and time.
const HEADER_LEN: usize = 1 + 4 + 8;

/// What the server says, but for data.
#[derive(Debug, Serialize)]
#[serde(tag = "op", rename_all = "camelCase")]
pub enum ServerMessage<'a> {
    /// First of all.
    #[serde(rename_all = "camelCase")]
    ServerInfo {
        /// What it is.
        name: &'a str,
        /// What it offers beyond topics.
        capabilities: [&'a str; 0],
        /// What clients might publish in; viewers expect it all the same.
        supported_encodings: [&'a str; 1],
        /// By key.
        metadata: BTreeMap<&'a str, &'a str>,
        /// Another one is another server.
        session_id: &'a str,
    },
    /// Something to be shown to the user.
    Status {
        /// How bad it is.
        level: Level,
        /// In words.
        message: &'a str,
    },
    /// Channels that have come.
    Advertise {
        /// Each.
        channels: Vec<Advertised<'a>>,
    },
    /// Channels that have gone.
    #[serde(rename_all = "camelCase")]
    Unadvertise {
        /// Each.
        channel_ids: &'a [u32],
    },
}

/// How bad something is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(into = "u8")]
pub enum Level {
    /// It is not.
    Info,
    /// Something is missing.
    Warning,
    /// What was asked for is not done.
    Error,
}

impl From<Level> for u8 {
    fn from(level: Level) -> Self {
        match level {
            Level::Info => 0,
            Level::Warning => 1,
            Level::Error => 2,
        }
    }
}

/// A channel, as it is advertised.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Advertised<'a> {
    id: u32,
    topic: &'a str,
    encoding: &'static str,
    schema_name: &'a str,
    schema_encoding: &'static str,
    schema: &'a str,
}

impl<'a> Advertised<'a> {
    /// A channel with messages of `schema_name`, `package/msg/Type`, which the text `schema` defines.
    pub fn new(id: u32, topic: &'a str, schema_name: &'a str, schema: &'a str) -> Self {
        Self {
            id,
            topic,
            encoding: ENCODING,
            schema_name,
            schema_encoding: SCHEMA_ENCODING,
            schema,
        }
    }
}

impl<'a> ServerMessage<'a> {
    /// The first message.
    pub fn server_info(session_id: &'a str) -> Self {
        Self::ServerInfo {
            name: "wm view",
            capabilities: [],
            supported_encodings: [ENCODING],
            metadata: [("ROS_DISTRO", DISTRIBUTION)].into(),
            session_id,
        }
    }

    /// As JSON.
    pub fn text(&self) -> String {
        // Numbers, texts and lists of them: nothing that JSON does not have.
        serde_json::to_string(self).unwrap_or_default()
    }
}

/// What a client asks for.
#[derive(Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
pub enum ClientMessage {
    /// The messages of channels.
    Subscribe {
        /// Each.
        subscriptions: Vec<Subscription>,
    },
    /// No more of them.
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        /// Each.
        subscription_ids: Vec<u32>,
    },
    /// What is not offered.
    #[serde(other)]
    Other,
}

/// A subscription that is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Subscription {
    /// What the client calls it.
    pub id: u32,
    /// The channel.
    pub channel_id: u32,
}

impl ClientMessage {
    /// Reads what a client has sent.
    ///
    /// # Errors
    /// It is no message of the protocol, in words.
    pub fn parse(text: &str) -> Result<Self, String> {
        serde_json::from_str(text).map_err(|error| format!("no message of the protocol: {error}"))
    }
}

/// A message of a subscription: an octet, the subscription and the time of reception \[ns\], little-endian, and the CDR.
pub fn data(subscription: u32, log_time_ns: u64, cdr: &[u8]) -> Bytes {
    let mut bytes = BytesMut::with_capacity(HEADER_LEN + cdr.len());
    bytes.put_u8(MESSAGE_DATA);
    bytes.put_u32_le(subscription);
    bytes.put_u64_le(log_time_ns);
    bytes.put_slice(cdr);
    bytes.freeze()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::{collection::vec, prelude::*};
    use serde_json::{Value, json};

    fn json_of(told: &ServerMessage<'_>) -> Value {
        serde_json::from_str(&told.text()).unwrap()
    }

    /// Field by field as the specification has it.
    #[test]
    fn what_is_told_is_what_the_specification_says() {
        assert_eq!(
            json_of(&ServerMessage::server_info("7")),
            json!({
                "op": "serverInfo", "name": "wm view", "capabilities": [], "supportedEncodings": ["cdr"],
                "metadata": {"ROS_DISTRO": "kilted"}, "sessionId": "7",
            })
        );
        let channels = vec![Advertised::new(
            3,
            "/a",
            "std_msgs/msg/String",
            "string data\n",
        )];
        assert_eq!(
            json_of(&ServerMessage::Advertise { channels }),
            json!({"op": "advertise", "channels": [{
                "id": 3, "topic": "/a", "encoding": "cdr", "schemaName": "std_msgs/msg/String",
                "schemaEncoding": "ros2msg", "schema": "string data\n",
            }]})
        );
        let channel_ids = &[1, 2];
        assert_eq!(
            json_of(&ServerMessage::Unadvertise { channel_ids }),
            json!({"op": "unadvertise", "channelIds": [1, 2]})
        );
        for (level, number) in [(Level::Info, 0), (Level::Warning, 1), (Level::Error, 2)] {
            assert_eq!(
                json_of(&ServerMessage::Status {
                    level,
                    message: "so"
                }),
                json!({"op": "status", "level": number, "message": "so"})
            );
        }
    }

    #[test]
    fn what_is_not_offered_is_told_from_what_is_none() {
        for other in [
            r#"{"op":"getParameters","parameterNames":[],"id":"1"}"#,
            r#"{"op":"advertise","channels":[{"id":1,"topic":"/a","encoding":"cdr","schemaName":"b"}]}"#,
            r#"{"op":"subscribeConnectionGraph"}"#,
        ] {
            assert_eq!(
                ClientMessage::parse(other),
                Ok(ClientMessage::Other),
                "{other}"
            );
        }
        for none in [
            "",
            "{}",
            "[1]",
            r#"{"op":7}"#,
            r#"{"op":"subscribe"}"#,
            r#"{"op":"subscribe","subscriptions":[{"id":-1,"channelId":1}]}"#,
            r#"{"op":"unsubscribe","subscriptionIds":[4294967296]}"#,
        ] {
            assert!(ClientMessage::parse(none).is_err(), "{none}");
        }
    }

    proptest! {
        #[test]
        fn data_is_found_where_the_specification_puts_it(
            subscription: u32, time: u64, cdr in vec(any::<u8>(), 0..64),
        ) {
            let bytes = data(subscription, time, &cdr);
            prop_assert_eq!(bytes[0], 1);
            prop_assert_eq!(u32::from_le_bytes(bytes[1..5].try_into().unwrap()), subscription);
            prop_assert_eq!(u64::from_le_bytes(bytes[5..13].try_into().unwrap()), time);
            prop_assert_eq!(&bytes[13..], &cdr[..]);
        }

        #[test]
        fn subscriptions_are_read_as_they_were_written(pairs in vec(any::<(u32, u32)>(), 0..20)) {
            let written: Vec<_> = pairs.iter().map(|(id, channel)| json!({"id": id, "channelId": channel})).collect();
            let text = json!({"op": "subscribe", "subscriptions": written}).to_string();
            let subscriptions = pairs.iter().map(|&(id, channel_id)| Subscription { id, channel_id }).collect();
            prop_assert_eq!(ClientMessage::parse(&text), Ok(ClientMessage::Subscribe { subscriptions }));
            let subscription_ids: Vec<u32> = pairs.iter().map(|(id, _)| *id).collect();
            let text = json!({"op": "unsubscribe", "subscriptionIds": subscription_ids}).to_string();
            prop_assert_eq!(ClientMessage::parse(&text), Ok(ClientMessage::Unsubscribe { subscription_ids }));
        }

        #[test]
        fn whatever_is_told_is_json(text in "\\PC*", id: u32) {
            let channels = vec![Advertised::new(id, &text, &text, &text)];
            let told = json_of(&ServerMessage::Advertise { channels });
            prop_assert_eq!(&told["channels"][0]["schema"], &text);
            prop_assert_eq!(&told["channels"][0]["id"], id);
        }

        #[test]
        fn whatever_comes_is_judged(text in "\\PC{0,80}", inner in "[a-zA-Z0-9:,\\[\\]{}\"]{0,60}") {
            let _ = ClientMessage::parse(&text);
            let _ = ClientMessage::parse(&format!("{{\"op\":\"subscribe\",{inner}}}"));
        }
    }
}
