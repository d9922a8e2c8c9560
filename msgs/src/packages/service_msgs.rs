//! Package `service_msgs`: what every service type names besides its own parts. No Rust type: nothing here sends it.

use super::{Named, builtin_interfaces::Time};
use crate::Message;

/// Name and definition of the first field of a service's event.
pub(crate) const SERVICE_EVENT_INFO: (&str, &str) = (
    "service_msgs/msg/ServiceEventInfo",
    "uint8 REQUEST_SENT=0\nuint8 REQUEST_RECEIVED=1\nuint8 RESPONSE_SENT=2\nuint8 RESPONSE_RECEIVED=3\n\
     uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\nint64 sequence_number\n",
);

/// The type that it names.
pub(crate) const TIME: (&str, &str) = (Time::ROS_NAME, Time::DEFINITION);
