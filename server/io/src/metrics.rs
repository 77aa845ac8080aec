//! One page of text over HTTP, for Prometheus. The caller replaces the whole page.

use crate::fail::Fail;
use crate::http::{Door, Places};
use axum::Router;
use axum::extract::State;
use axum::http::{Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use std::ffi::CString;
use std::sync::{Arc, Mutex};

/// Most readers at a time: a few Prometheus servers, each of which keeps a connection or two.
const MAX_READERS: usize = 64;

struct Shared {
    page: Mutex<String>,
    places: Arc<Places>,
}

pub struct Metrics {
    shared: Arc<Shared>,
    door: Door,
}

impl Metrics {
    pub fn open(address: &str) -> Result<Metrics, Fail> {
        let mut door = Door::open("metrics", address, MAX_READERS)?;
        let shared = Arc::new(Shared { page: Mutex::default(), places: door.places.clone() });
        door.serve(Router::new().fallback(answer).with_state(shared.clone()));
        Ok(Metrics { shared, door })
    }

    pub fn address(&self) -> &CString {
        self.door.address()
    }

    pub fn set(&self, page: &str) {
        *self.shared.page.lock().unwrap() = page.to_string();
    }
}

async fn answer(State(shared): State<Arc<Shared>>, method: Method, uri: Uri) -> Response {
    if method != Method::GET || uri.path() != "/metrics" {
        return (StatusCode::NOT_FOUND, "there is nothing but GET /metrics\n").into_response();
    }
    let page = shared.page.lock().unwrap().clone();
    let own = format!(
        "# HELP crumple_http_refused_total Connections to this page that found all places taken.\n\
         # TYPE crumple_http_refused_total counter\ncrumple_http_refused_total {}\n",
        shared.places.refused()
    );
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], page + &own).into_response()
}
