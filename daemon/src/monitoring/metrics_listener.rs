//! The door for whoever scrapes: HTTP/1.1, one page, read only, every length, time and number of callers bounded.

use std::collections::VecDeque;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::AbortHandle;

use crate::panics::containment::{Ends, answer};

/// Bytes of a request with all its headers.
const LONGEST: usize = 8192;
/// Callers at once. One more takes the place of the one that has been there longest: who asks and reads is gone in a
/// moment, so it is the slow who make way, and however many they are, the page is served.
const CALLERS: usize = 8;
/// A caller is done with by then.
const PATIENCE: Duration = Duration::from_secs(5);

/// What is answered.
struct Answer {
    status: &'static str,
    content: &'static str,
    body: String,
}

impl Answer {
    fn error(status: &'static str) -> Self {
        Self {
            status,
            content: "text/plain; charset=utf-8",
            body: format!("{status}\n"),
        }
    }
}

/// A door that is open until it is dropped.
#[derive(Debug)]
pub(crate) struct MetricsListener {
    pub address: SocketAddr,
    task: tokio::task::JoinHandle<()>,
}

impl Drop for MetricsListener {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl MetricsListener {
    /// Opens it for callers who know this machine by its address or one of these names; `page` makes what is at
    /// `/metrics`.
    ///
    /// # Errors
    /// The address cannot be had.
    pub(crate) async fn open<F>(
        address: SocketAddr,
        names: Vec<String>,
        content: &'static str,
        page: impl Fn() -> F + Send + Sync + 'static,
    ) -> std::io::Result<Self>
    where
        F: Future<Output = String> + Send + 'static,
    {
        let listener = TcpListener::bind(address).await?;
        let address = listener.local_addr()?;
        let task = tokio::spawn(listen(listener, names.into(), content, Arc::new(page)));
        Ok(Self { address, task })
    }
}

async fn listen<F>(
    listener: TcpListener,
    names: Arc<[String]>,
    content: &'static str,
    page: Arc<impl Fn() -> F + Send + Sync + 'static>,
) where
    F: Future<Output = String> + Send + 'static,
{
    let mut callers = Callers::default();
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            // no descriptors: a moment later there may be some
            tokio::time::sleep(Duration::from_millis(100)).await;
            continue;
        };
        callers.make_room();
        let (names, page) = (Arc::clone(&names), Arc::clone(&page));
        let caller = tokio::spawn(async move {
            let attended = attend(stream, &names, content, page.as_ref());
            let _ = answer(Ends::Answer, tokio::time::timeout(PATIENCE, attended)).await;
        });
        callers.0.push_back(caller.abort_handle());
    }
}

/// Those who are talked with, the first the one that has been there longest; they go when the door does.
#[derive(Debug, Default)]
struct Callers(VecDeque<AbortHandle>);

impl Callers {
    fn make_room(&mut self) {
        self.0.retain(|caller| !caller.is_finished());
        while self.0.len() >= CALLERS
            && let Some(longest) = self.0.pop_front()
        {
            longest.abort();
        }
    }
}

impl Drop for Callers {
    fn drop(&mut self) {
        self.0.iter().for_each(AbortHandle::abort);
    }
}

async fn attend<F: Future<Output = String>>(
    stream: TcpStream,
    names: &[String],
    content: &'static str,
    page: &(impl Fn() -> F + Sync),
) -> std::io::Result<()> {
    let known = OwnNames {
        own: stream.local_addr()?.ip(),
        names,
    };
    talk(stream, &known, content, page).await
}

/// One question, one answer.
async fn talk<S, F>(
    mut stream: S,
    known: &OwnNames<'_>,
    content: &'static str,
    page: &(impl Fn() -> F + Sync),
) -> std::io::Result<()>
where
    S: AsyncRead + AsyncWrite + Unpin,
    F: Future<Output = String>,
{
    let head = head(&mut stream).await?;
    let (bodiless, answer) = match head.as_deref().map(|head| question(head, known)) {
        None => (false, Answer::error("431 Request Header Fields Too Large")),
        Some(Err(status)) => (false, Answer::error(status)),
        Some(Ok(method)) => {
            let body = page().await;
            let answer = Answer {
                status: "200 OK",
                content,
                body,
            };
            (method == Method::Head, answer)
        }
    };
    let Answer {
        status,
        content,
        body,
    } = answer;
    let mut text = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {content}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    if !bodiless {
        text.push_str(&body);
    }
    stream.write_all(text.as_bytes()).await?;
    stream.shutdown().await
}

/// Everything up to the empty line; `None` where that is too long.
async fn head(stream: &mut (impl AsyncRead + Unpin)) -> std::io::Result<Option<Vec<u8>>> {
    let mut head = Vec::with_capacity(512);
    let mut piece = [0; 1024];
    loop {
        if let Some(end) = head.windows(4).position(|four| four == b"\r\n\r\n") {
            head.truncate(end);
            return Ok(Some(head));
        }
        if head.len() >= LONGEST {
            return Ok(None);
        }
        let most = piece.len().min(LONGEST - head.len());
        let read = stream.read(&mut piece[..most]).await?;
        if read == 0 {
            return Err(std::io::ErrorKind::UnexpectedEof.into());
        }
        head.extend_from_slice(&piece[..read]);
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Method {
    Get,
    Head,
}

/// What is asked, and of whom; the other headers say nothing that matters here.
fn question(head: &[u8], known: &OwnNames<'_>) -> Result<Method, &'static str> {
    const BAD: &str = "400 Bad Request";
    let head = std::str::from_utf8(head).map_err(|_| BAD)?;
    let mut lines = head.split("\r\n");
    let line = lines.next().unwrap_or_default();
    let words: Vec<&str> = line.split(' ').collect();
    let [method, target, version] = words[..] else {
        return Err(BAD);
    };
    let hosts: Vec<&str> = lines
        .filter_map(|line| line.split_once(':'))
        .filter(|(name, _)| name.eq_ignore_ascii_case("host"))
        .map(|(_, value)| value.trim())
        .collect();
    match (version, hosts[..].first()) {
        _ if hosts.len() > 1 => return Err(BAD),
        ("HTTP/1.1" | "HTTP/1.0", Some(host)) if known.is(host) => {}
        // a page of a stranger in the browser of somebody here, whose name has been made to mean this machine
        ("HTTP/1.1" | "HTTP/1.0", Some(_)) => return Err("421 Misdirected Request"),
        ("HTTP/1.0", None) => {}
        _ => return Err(BAD),
    }
    let method = match method {
        "GET" => Method::Get,
        "HEAD" => Method::Head,
        _ => return Err("405 Method Not Allowed"),
    };
    match target.split('?').next() {
        Some("/metrics") => Ok(method),
        _ => Err("404 Not Found"),
    }
}

/// By what a caller may know this machine. Any other name may be a stranger's.
#[derive(Debug)]
struct OwnNames<'a> {
    /// The address at which the caller came.
    own: IpAddr,
    /// As configured.
    names: &'a [String],
}

impl OwnNames<'_> {
    /// Whether a host, with or without a port, is this machine: `localhost`, a loopback address, the address at which the
    /// caller came, or a configured name.
    fn is(&self, host: &str) -> bool {
        let name = match host.strip_prefix('[') {
            Some(rest) => rest.split(']').next().unwrap_or_default(),
            None => host.split(':').next().unwrap_or_default(),
        };
        if let Ok(address) = name.parse::<IpAddr>() {
            let address = address.to_canonical();
            return address.is_loopback() || address == self.own.to_canonical();
        }
        let name = name.strip_suffix('.').unwrap_or(name);
        let configured = self.names.iter().map(String::as_str);
        configured
            .chain(["localhost"])
            .any(|known| known.eq_ignore_ascii_case(name))
    }
}

#[cfg(test)]
mod tests {
    use crate::monitoring::metrics_listener::*;
    use tokio::io::DuplexStream;

    const DEADLINE: Duration = Duration::from_secs(120);

    async fn ask(request: &[u8]) -> String {
        let (mut caller, stream): (DuplexStream, _) = tokio::io::duplex(64 * 1024);
        caller.write_all(request).await.unwrap();
        let page = || async { "tactus_well 1\n# EOF\n".to_owned() };
        let known = OwnNames {
            own: IpAddr::from([192, 0, 2, 7]),
            names: &["rig.example".to_owned()],
        };
        let _ = talk(stream, &known, "text/x", &page).await;
        let mut answer = Vec::new();
        caller.read_to_end(&mut answer).await.unwrap();
        String::from_utf8(answer).unwrap()
    }

    #[tokio::test]
    async fn one_page_is_served_and_nothing_else() {
        let answer = ask(b"GET /metrics HTTP/1.1\r\nHost: localhost:9617\r\n\r\n").await;
        assert!(answer.starts_with("HTTP/1.1 200 OK\r\nContent-Type: text/x\r\n"));
        assert!(
            answer.ends_with("\r\n\r\ntactus_well 1\n# EOF\n"),
            "{answer}"
        );
        let answer = ask(b"HEAD /metrics?a=b HTTP/1.0\r\n\r\n").await;
        assert!(answer.contains("Content-Length: 20") && answer.ends_with("\r\n\r\n"));
        for (request, status) in [
            (&b"GET / HTTP/1.1\r\nHost: [::1]\r\n\r\n"[..], "404"),
            (
                b"GET /metrics/../etc HTTP/1.1\r\nHost: [::1]\r\n\r\n",
                "404",
            ),
            (b"POST /metrics HTTP/1.1\r\nHost: [::1]\r\n\r\n", "405"),
            (b"GET /metrics HTTP/9\r\n\r\n", "400"),
            (b"GET /metrics\r\n\r\n", "400"),
            (b"GET /metrics HTTP/1.1\r\n\r\n", "400"),
            (b"\r\n\r\n", "400"),
            (b"\xff\xfe\r\n\r\n", "400"),
        ] {
            let answer = ask(request).await;
            let wanted = format!("HTTP/1.1 {status}");
            assert!(answer.starts_with(&wanted), "{answer}");
        }
        let mut long = b"GET /metrics HTTP/1.1\r\n".to_vec();
        while long.len() < 60_000 {
            long.extend_from_slice(b"X-Header: of no interest\r\n");
        }
        assert!(ask(&long).await.starts_with("HTTP/1.1 431"));
        let line = [b"GET /".to_vec(), vec![b'a'; 50_000]].concat();
        assert!(ask(&line).await.starts_with("HTTP/1.1 431"));
    }

    #[tokio::test]
    async fn a_host_that_is_not_ours_is_refused() {
        for (host, status) in [
            ("127.0.0.1:9617", "200"),
            ("127.0.0.2", "200"),
            ("[::1]:9617", "200"),
            ("LocalHost.", "200"),
            ("192.0.2.7:9617", "200"),
            ("192.0.2.8:9617", "421"),
            ("Rig.example:9617", "200"),
            ("other.example", "421"),
            ("attacker.example:9617", "421"),
            ("localhost.attacker.example", "421"),
            ("127.0.0.1.attacker.example", "421"),
            ("[::1", "200"),
            ("", "421"),
            ("localhost\r\nHost: attacker.example", "400"),
        ] {
            for version in ["HTTP/1.0", "HTTP/1.1"] {
                let request = format!("GET /metrics {version}\r\nhOST: {host}\r\n\r\n");
                let answer = ask(request.as_bytes()).await;
                let wanted = format!("HTTP/1.1 {status}");
                assert!(answer.starts_with(&wanted), "{host}: {answer}");
            }
        }
    }

    #[tokio::test]
    async fn silent_callers_make_way_and_are_hung_up_on() {
        let local = SocketAddr::from(([127, 0, 0, 1], 0));
        let page = || async { "page".to_owned() };
        let listener = MetricsListener::open(local, Vec::new(), "text/x", page)
            .await
            .unwrap();
        let silent = async |said: &[u8]| {
            let mut caller = TcpStream::connect(listener.address).await.unwrap();
            caller.write_all(said).await.unwrap();
            caller
        };
        let mut callers = Vec::new();
        for _ in 0..CALLERS {
            callers.push(silent(b"GET /met").await);
        }
        // in the order of connections: the first two make way for these
        let mut late = silent(b"GET /metrics HTTP/1.0\r\n\r\n").await;
        callers.push(silent(b"").await);
        let mut answer = Vec::new();
        let answered = tokio::time::timeout(DEADLINE, late.read_to_end(&mut answer)).await;
        answered.unwrap().unwrap();
        assert!(answer.starts_with(b"HTTP/1.1 200"));
        for mut caller in callers {
            let mut answer = Vec::new();
            let over = tokio::time::timeout(DEADLINE, caller.read_to_end(&mut answer)).await;
            let _ = over.unwrap();
            assert!(answer.is_empty());
        }
    }
}
