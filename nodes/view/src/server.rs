//! Serves the page over HTTP, and sockets on its port.

use crate::{
    ViewError,
    access::Refusal,
    foxglove::{client, hub::MAX_MESSAGE},
    listener::Connections,
    page,
    picture::{Label, MAX_BYTES, Picture, Source},
    shared::{Settings, Shared},
    socket,
    subprotocol::Subprotocol,
};
use axum::{
    Router,
    extract::{
        Path, Request, State as Extracted, WebSocketUpgrade,
        ws::rejection::WebSocketUpgradeRejection,
    },
    http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, header},
    middleware::{self, Next},
    response::{IntoResponse as _, Response},
    routing::get,
};
use std::{net::SocketAddr, sync::Arc};
use tokio::net::TcpListener;

/// Longest message of a client \[byte\]: a command has some hundred.
const MAX_COMMAND: usize = 4 << 10;
/// Connections per client: a socket, and those that a browser opens for pictures.
const CONNECTIONS: usize = 8;
/// Why a socket with another protocol is refused.
const NO_PROTOCOL: &str = "expected the subprotocol wm.view.v1, or one of Foxglove's where the parameter foxglove_regex offers \
    topics";

/// Listens on an address.
///
/// # Errors
/// The address is taken, or not of this machine.
pub(crate) async fn listen(address: SocketAddr) -> Result<(TcpListener, SocketAddr), ViewError> {
    let refused = |reason| ViewError::Listen { address, reason };
    let listener = TcpListener::bind(address).await.map_err(refused)?;
    let bound = listener.local_addr().map_err(refused)?;
    Ok((listener, bound))
}

/// Serves the page until the task is dropped.
pub(crate) async fn serve(listener: TcpListener, shared: Arc<Shared>) {
    let limit = shared.settings().max_clients * CONNECTIONS;
    let connections = Connections::new(listener, limit, shared.refused());
    if let Err(error) = axum::serve(connections, router(shared)).await {
        tracing::error!("the page is no longer served: {error}");
    }
}

fn router(shared: Arc<Shared>) -> Router {
    let inside = Router::new()
        .route("/access", get(|| async { StatusCode::NO_CONTENT }))
        .route("/picture/{source}/{stamp}/{observed}/{k}", get(picture))
        .route_layer(middleware::from_fn_with_state(
            Arc::clone(&shared),
            with_token,
        ));
    let mut router = Router::new().route("/socket", get(connect));
    for file in page::FILES {
        let page = ([(header::CONTENT_TYPE, file.media_type)], file.text);
        // viewers connect to the bare address
        let serve = async move |sharing: Sharing,
                                headers: HeaderMap,
                                uri: Uri,
                                upgrade: Upgrade| match upgrade {
            Ok(upgrade) if file.path == "/" => connect(sharing, headers, uri, upgrade).await,
            _ => page.into_response(),
        };
        router = router.route(file.path, get(serve));
    }
    router
        .merge(inside)
        .layer(middleware::from_fn_with_state(
            Arc::clone(&shared),
            of_own_page,
        ))
        .with_state(shared)
}

impl From<Refusal> for Response {
    fn from(refusal: Refusal) -> Self {
        (refusal.status(), refusal.text()).into_response()
    }
}

type Sharing = Extracted<Arc<Shared>>;
type Upgrade = Result<WebSocketUpgrade, WebSocketUpgradeRejection>;

/// Refuses requests to other hosts and of other pages, and makes browsers strict.
async fn of_own_page(Extracted(shared): Sharing, request: Request, next: Next) -> Response {
    let mut response = match check_origin(shared.settings(), request.headers()) {
        Ok(()) => next.run(request).await,
        Err(refusal) => refusal.into(),
    };
    let headers: [(HeaderName, HeaderValue); 5] = [
        (
            header::CONTENT_SECURITY_POLICY,
            HeaderValue::from_static(page::POLICY),
        ),
        (
            header::X_CONTENT_TYPE_OPTIONS,
            HeaderValue::from_static("nosniff"),
        ),
        (
            header::REFERRER_POLICY,
            HeaderValue::from_static("no-referrer"),
        ),
        (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
        (
            HeaderName::from_static("cross-origin-resource-policy"),
            HeaderValue::from_static("same-origin"),
        ),
    ];
    response.headers_mut().extend(headers);
    response
}

fn check_origin(settings: &Settings, headers: &HeaderMap) -> Result<(), Refusal> {
    let (Some(Subprotocol::Foxglove(_)), Some(hub)) =
        (Subprotocol::of(headers), &settings.foxglove)
    else {
        return settings.access.check_origin(headers);
    };
    let checked = settings.access.check_viewer(headers);
    if let (Err(Refusal::Origin), Some(origin)) = (checked, headers.get(header::ORIGIN)) {
        hub.warn_of_origin(origin.to_str().unwrap_or_default());
    }
    checked
}

async fn with_token(Extracted(shared): Sharing, request: Request, next: Next) -> Response {
    match shared
        .settings()
        .access
        .check_token(request.headers(), None)
    {
        Ok(()) => next.run(request).await,
        Err(refusal) => refusal.into(),
    }
}

/// A picture of the last minute or of the bag.
async fn picture(
    Extracted(shared): Sharing,
    Path((source, stamp_ns, observed_ns, step)): Path<(String, i64, i64, u8)>,
) -> Response {
    let Some(source) = Source::named(&source) else {
        return StatusCode::NOT_FOUND.into_response();
    };
    let label = Label {
        source,
        step,
        stamp_ns,
        observed_ns,
    };
    match find(&shared, label).await {
        Ok(Some(picture)) => {
            let media_type = [(header::CONTENT_TYPE, picture.format.media_type())];
            (media_type, picture.data()).into_response()
        }
        Ok(None) => (StatusCode::NOT_FOUND, "this picture has expired").into_response(),
        Err(reason) => (StatusCode::INTERNAL_SERVER_ERROR, reason).into_response(),
    }
}

/// Finds a picture of the last minute or of the bag.
///
/// # Errors
/// The bag cannot be read there; the reason as text.
pub(crate) async fn find(shared: &Shared, label: Label) -> Result<Option<Arc<Picture>>, String> {
    match &shared.settings().bag {
        Some(bag) => Arc::clone(bag).picture(label).await,
        None => Ok(shared.known().state.album.find(&label).cloned()),
    }
}

async fn connect(
    Extracted(shared): Sharing,
    headers: HeaderMap,
    uri: Uri,
    upgrade: WebSocketUpgrade,
) -> Response {
    let spoken = Subprotocol::of(&headers);
    let query = match spoken {
        Some(Subprotocol::Foxglove(_)) => uri.query(),
        _ => None,
    };
    if let Err(refusal) = shared.settings().access.check_token(&headers, query) {
        return refusal.into();
    }
    let (spoken, hub) = match (spoken, &shared.settings().foxglove) {
        (Some(spoken @ Subprotocol::View), _) => (spoken, None),
        (Some(spoken @ Subprotocol::Foxglove(_)), Some(hub)) => (spoken, Some(Arc::clone(hub))),
        _ => {
            let offered = headers.get(header::SEC_WEBSOCKET_PROTOCOL);
            tracing::debug!("a socket with the subprotocols {offered:?} is refused");
            return (StatusCode::BAD_REQUEST, NO_PROTOCOL).into_response();
        }
    };
    let (longest_in, longest_out) = match hub {
        Some(_) => (client::MAX_REQUEST, MAX_MESSAGE),
        None => (MAX_COMMAND, MAX_BYTES),
    };
    let upgrade = upgrade
        .protocols([spoken.name()])
        .max_message_size(longest_in)
        .max_frame_size(longest_in)
        // send each message at once
        .write_buffer_size(0)
        .max_write_buffer_size(2 * longest_out);
    let Some(place) = shared.admit() else {
        return (
            StatusCode::SERVICE_UNAVAILABLE,
            "as many clients as max_clients allows",
        )
            .into_response();
    };
    upgrade.on_upgrade(async move |socket| {
        match hub {
            Some(hub) => client::serve(socket, &hub, shared.settings().bag.is_some()).await,
            None => socket::serve(socket, &shared).await,
        }
        drop(place);
    })
}
