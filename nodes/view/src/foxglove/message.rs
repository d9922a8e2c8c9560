//! The messages of the protocol that a viewer needs.

use bytes::{BufMut as _, Bytes, BytesMut};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// CDR with its header of four bytes.
const ENCODING: &str = "cdr";
/// `.msg` text with all types that it uses.
pub(crate) const SCHEMA_ENCODING: &str = "ros2msg";
/// The ROS distribution of the server. Viewers take types that a definition lacks from it; wm's definitions are complete.
const DISTRIBUTION: &str = "kilted";
/// The operation of a binary message with data.
const MESSAGE_DATA: u8 = 1;
/// Operation, subscription and time.
const HEADER_LEN: usize = 1 + 4 + 8;

/// A message of the server, except data.
#[derive(Debug, Serialize)]
#[serde(tag = "op", rename_all = "camelCase")]
pub(crate) enum ServerMessage<'a> {
    /// The first message.
    #[serde(rename_all = "camelCase")]
    ServerInfo {
        name: &'a str,
        /// Features beyond topics.
        capabilities: [&'a str; 0],
        /// Encodings for publishing clients; viewers require the field.
        supported_encodings: [&'a str; 1],
        metadata: BTreeMap<&'a str, &'a str>,
        /// Changes with the server.
        session_id: &'a str,
    },
    /// A message to the user.
    Status { level: Level, message: &'a str },
    /// New channels.
    Advertise { channels: Vec<ChannelAdvert<'a>> },
    /// Channels that have gone.
    #[serde(rename_all = "camelCase")]
    Unadvertise { channel_ids: &'a [u32] },
}

/// Severity of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(into = "u8")]
pub(crate) enum Level {
    Info,
    Warning,
    /// The request was not executed.
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

/// A channel in [`ServerMessage::Advertise`].
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct ChannelAdvert<'a> {
    id: u32,
    topic: &'a str,
    encoding: &'static str,
    schema_name: &'a str,
    schema_encoding: &'static str,
    schema: &'a str,
}

impl<'a> ChannelAdvert<'a> {
    /// `schema_name`: `package/msg/Type`; `schema`: its definition.
    pub(crate) fn new(id: u32, topic: &'a str, schema_name: &'a str, schema: &'a str) -> Self {
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
    pub(crate) fn server_info(session_id: &'a str) -> Self {
        Self::ServerInfo {
            name: "wm view",
            capabilities: [],
            supported_encodings: [ENCODING],
            metadata: [("ROS_DISTRO", DISTRIBUTION)].into(),
            session_id,
        }
    }

    /// As JSON.
    pub(crate) fn text(&self) -> String {
        // numbers, texts and lists always fit into JSON
        serde_json::to_string(self).unwrap_or_default()
    }
}

/// A request of a client.
#[derive(Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
pub(crate) enum ClientMessage {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    /// Not offered.
    #[serde(other)]
    Other,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Subscription {
    /// Chosen by the client.
    pub id: u32,
    pub channel_id: u32,
}

impl ClientMessage {
    /// Parses a client's message.
    ///
    /// # Errors
    /// It is not a message of the protocol; the reason as text.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        serde_json::from_str(text)
            .map_err(|error| format!("not a message of the protocol: {error}"))
    }
}

/// A message of a subscription: an octet, the subscription and the time of reception \[ns\], little-endian, and the
/// CDR.
pub(crate) fn data(subscription: u32, log_time_ns: u64, cdr: &[u8]) -> Bytes {
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

    fn json_of(sent: &ServerMessage<'_>) -> Value {
        serde_json::from_str(&sent.text()).unwrap()
    }

    /// Field by field as in the specification.
    #[test]
    fn messages_match_the_specification() {
        assert_eq!(
            json_of(&ServerMessage::server_info("7")),
            json!({
                "op": "serverInfo", "name": "wm view", "capabilities": [], "supportedEncodings": ["cdr"],
                "metadata": {"ROS_DISTRO": "kilted"}, "sessionId": "7",
            })
        );
        let channels = vec![ChannelAdvert::new(
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
    fn unsupported_requests_differ_from_invalid_messages() {
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
        fn server_messages_are_json(text in "\\PC*", id: u32) {
            let channels = vec![ChannelAdvert::new(id, &text, &text, &text)];
            let sent = json_of(&ServerMessage::Advertise { channels });
            prop_assert_eq!(&sent["channels"][0]["schema"], &text);
            prop_assert_eq!(&sent["channels"][0]["id"], id);
        }

        #[test]
        fn whatever_comes_is_judged(text in "\\PC{0,80}", inner in "[a-zA-Z0-9:,\\[\\]{}\"]{0,60}") {
            let _ = ClientMessage::parse(&text);
            let _ = ClientMessage::parse(&format!("{{\"op\":\"subscribe\",{inner}}}"));
        }
    }
}
