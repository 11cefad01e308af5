//! Who may ask over TCP: whoever has the token of this start, from the page itself or from no page.

use std::{io, sync::Arc};

use axum::{
    extract::{Request, State},
    http::{
        HeaderMap, HeaderValue, StatusCode,
        header::{AUTHORIZATION, HOST, HeaderName, ORIGIN, SEC_WEBSOCKET_PROTOCOL},
    },
    middleware::Next,
    response::{IntoResponse, Response},
};
use rustix::rand::{GetRandomFlags, getrandom};

use crate::{log::Log, page, refusal::Refusal};

/// What comes before the token among the protocols of a WebSocket, for which a page can give no other header.
const OFFERED: &str = "token.";

/// Made anew at each start: 128 bits from the kernel, in hexadecimal.
#[derive(Clone)]
pub(crate) struct Token(Arc<str>);

impl Token {
    pub fn new() -> io::Result<Self> {
        let mut bytes = [0; 16];
        let filled = getrandom(&mut bytes[..], GetRandomFlags::empty())?;
        if filled != bytes.len() {
            return Err(io::Error::other("the kernel gives too few random bytes"));
        }
        let text: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Self(text.into()))
    }

    pub fn text(&self) -> &str {
        &self.0
    }

    /// As the value of a header.
    pub fn value(&self) -> HeaderValue {
        // Hexadecimal digits are such a value.
        HeaderValue::from_str(&self.0).unwrap_or(HeaderValue::from_static(""))
    }

    /// Whether this is the token; it takes as long for every text of its length.
    fn is(&self, text: &str) -> bool {
        let pairs = self.0.bytes().zip(text.bytes());
        let differences = pairs.fold(0, |found, (one, other)| found | (one ^ other));
        text.len() == self.0.len() && differences == 0
    }
}

/// At the door of a TCP listener.
#[derive(Clone)]
pub(crate) struct Gate {
    pub token: Token,
    pub port: u16,
    pub log: Log,
}

impl Gate {
    /// Why this is refused.
    fn refusal(
        &self,
        headers: &HeaderMap,
        path: &str,
    ) -> Option<(StatusCode, &'static str, &'static str)> {
        let text = |name: &HeaderName| headers.get(name).and_then(|value| value.to_str().ok());
        let names = ["127.0.0.1", "localhost"];
        let own = names.map(|name| format!("{name}:{}", self.port));
        // Browsers leave out the port that http has.
        let is_own = |host: &str| {
            own.iter().any(|own| own == host) || self.port == 80 && names.contains(&host)
        };
        if !text(&HOST).is_some_and(is_own) {
            return Some((
                StatusCode::FORBIDDEN,
                "wrong_host",
                "ask for 127.0.0.1 or localhost with the port of this listener",
            ));
        }
        let from_own_page = |origin: &str| origin.strip_prefix("http://").is_some_and(is_own);
        if headers.contains_key(ORIGIN) && !text(&ORIGIN).is_some_and(from_own_page) {
            return Some((
                StatusCode::FORBIDDEN,
                "wrong_origin",
                "a page from elsewhere is not let in",
            ));
        }
        let bearer = text(&AUTHORIZATION).and_then(|value| value.strip_prefix("Bearer "));
        let mut protocols = text(&SEC_WEBSOCKET_PROTOCOL).unwrap_or_default().split(',');
        let offered = protocols.find_map(|protocol| protocol.trim().strip_prefix(OFFERED));
        let has_token = bearer.or(offered).is_some_and(|text| self.token.is(text));
        // The page itself shows nothing of the machine.
        (!has_token && !page::is_part(path)).then_some((
            StatusCode::UNAUTHORIZED,
            "no_token",
            "the token of this start is missing or wrong: open the address that the program shows",
        ))
    }
}

pub(crate) async fn check(State(gate): State<Gate>, mut request: Request, next: Next) -> Response {
    let refusal = gate.refusal(request.headers(), request.uri().path());
    if let Some((status, code, text)) = refusal {
        let path = request.uri().path();
        gate.log.warn(format_args!("refused {path}: {code}"));
        return Refusal::new(status, code, text).into_response();
    }
    request.headers_mut().remove(AUTHORIZATION);
    next.run(request).await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_token_the_host_and_the_origin_all_have_to_be_right() {
        let gate = Gate {
            token: Token::new().unwrap(),
            port: 8080,
            log: Log::default(),
        };
        let bearer = format!("Bearer {}", gate.token.text());
        let offered = format!("servocrab, token.{}", gate.token.text());
        let code = |headers: &[(HeaderName, &str)]| {
            let headers = headers.iter().cloned();
            let headers =
                headers.map(|(name, value)| (name, HeaderValue::from_str(value).unwrap()));
            gate.refusal(&headers.collect(), "/v1/axes")
                .map(|refusal| refusal.1)
        };
        let host = (HOST, "127.0.0.1:8080");
        assert_eq!(code(&[host.clone(), (AUTHORIZATION, &bearer)]), None);
        assert_eq!(
            code(&[(HOST, "localhost:8080"), (AUTHORIZATION, &bearer)]),
            None
        );
        let page = (ORIGIN, "http://127.0.0.1:8080");
        let socket = [host.clone(), page, (SEC_WEBSOCKET_PROTOCOL, &*offered)];
        assert_eq!(code(&socket), None);
        assert_eq!(code(std::slice::from_ref(&host)), Some("no_token"));
        let zeros = format!("Bearer {}", "0".repeat(32));
        for wrong in ["", "Bearer ", &bearer[..bearer.len() - 1], &zeros] {
            assert_eq!(
                code(&[host.clone(), (AUTHORIZATION, wrong)]),
                Some("no_token")
            );
        }
        for elsewhere in [
            "http://example.org",
            "null",
            "https://127.0.0.1:8080",
            "http://localhost:80",
        ] {
            let headers = [host.clone(), (ORIGIN, elsewhere), (AUTHORIZATION, &bearer)];
            assert_eq!(code(&headers), Some("wrong_origin"), "{elsewhere}");
        }
        for name in ["example.org:8080", "127.0.0.1", "127.0.0.1:80", ""] {
            let headers = [(HOST, name), (AUTHORIZATION, &bearer)];
            assert_eq!(code(&headers), Some("wrong_host"), "{name}");
        }
        assert_eq!(code(&[(AUTHORIZATION, &bearer)]), Some("wrong_host"));
        let usual = Gate {
            port: 80,
            ..gate.clone()
        };
        for name in ["localhost", "127.0.0.1", "localhost:80"] {
            let own = HeaderMap::from_iter([(HOST, HeaderValue::from_static(name))]);
            assert_eq!(usual.refusal(&own, "/"), None, "{name}");
        }
        let none = HeaderMap::from_iter([(HOST, HeaderValue::from_static("localhost:8080"))]);
        assert_eq!(
            gate.refusal(&none, "/"),
            None,
            "the page shows nothing of the machine"
        );
        assert_ne!(gate.token.text(), Token::new().unwrap().text());
    }
}
