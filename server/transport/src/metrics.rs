//! One page of text over HTTP, for Prometheus. The owner replaces it whole; a thread of its own answers, so a slow or hostile
//! reader holds up nobody else.

use crate::fail::{BAD_ARGUMENT, Fail, IO};
use std::ffi::CString;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use tiny_http::{Header, Method, Request, Response, Server};

pub struct Metrics {
    server: Arc<Server>,
    page: Arc<Mutex<String>>,
    thread: Option<JoinHandle<()>>,
    address: CString,
}

impl Metrics {
    pub fn open(address: &str) -> Result<Metrics, Fail> {
        if !address.contains(':') {
            return Err(Fail::new(BAD_ARGUMENT, format!("metrics at {address}: give HOST:PORT, such as 127.0.0.1:9464")));
        }
        let server = Server::http(address).map_err(|e| {
            Fail::new(IO, format!("cannot show metrics at {address}: is the port free and the address this machine's? ({e})"))
        })?;
        let address = CString::new(server.server_addr().to_string()).unwrap_or_default();
        let (server, page) = (Arc::new(server), Arc::new(Mutex::new(String::new())));
        let thread = {
            let (server, page) = (server.clone(), page.clone());
            std::thread::Builder::new().name("metrics".into()).spawn(move || {
                for request in server.incoming_requests() {
                    answer(request, &page);
                }
            })
        };
        let thread = thread.map_err(|e| Fail::new(IO, format!("no thread for metrics ({e}); raise the limit of threads")))?;
        Ok(Metrics { server, page, thread: Some(thread), address })
    }

    pub fn address(&self) -> &CString {
        &self.address
    }

    pub fn set(&self, page: &str) {
        *self.page.lock().unwrap() = page.to_string();
    }
}

impl Drop for Metrics {
    fn drop(&mut self) {
        self.server.unblock();
        _ = self.thread.take().map(JoinHandle::join);
    }
}

/// What is sent is a copy: no reader holds the lock. A reader who is gone needs no answer.
fn answer(request: Request, page: &Mutex<String>) {
    _ = if *request.method() != Method::Get || request.url() != "/metrics" {
        request.respond(Response::from_string("GET /metrics is all there is\n").with_status_code(404))
    } else {
        let text = page.lock().unwrap().clone();
        let kind = Header::from_bytes("Content-Type", "text/plain; version=0.0.4; charset=utf-8").unwrap();
        request.respond(Response::from_string(text).with_header(kind))
    };
}
