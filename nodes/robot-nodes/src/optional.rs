//! Optional subscriptions.

use wm_msgs::Message;
use wm_ros::{Received, Subscription};

/// The next message; pending without a subscription.
pub(crate) async fn next<M: Message>(
    subscription: &mut Option<Subscription<M>>,
) -> Option<Received<M>> {
    match subscription {
        Some(subscription) => subscription.recv().await,
        None => std::future::pending().await,
    }
}
