//! The door for whoever scrapes: HTTP/1.1, one page, read only, every length, time and number of callers bounded.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;

/// Bytes of a request with all its headers.
const LONGEST: usize = 8192;
/// Callers at once; others are hung up on.
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
    fn refusal(status: &'static str) -> Self {
        Self {
            status,
            content: "text/plain; charset=utf-8",
            body: format!("{status}\n"),
        }
    }
}

/// A door that is open until it is dropped.
#[derive(Debug)]
pub(crate) struct Door {
    pub address: SocketAddr,
    task: tokio::task::JoinHandle<()>,
}

impl Drop for Door {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl Door {
    /// Opens it; `page` makes what is at `/metrics`.
    ///
    /// # Errors
    /// The address cannot be had.
    pub(crate) async fn open<F>(
        address: SocketAddr,
        content: &'static str,
        page: impl Fn() -> F + Send + Sync + 'static,
    ) -> std::io::Result<Self>
    where
        F: Future<Output = String> + Send + 'static,
    {
        let listener = TcpListener::bind(address).await?;
        let address = listener.local_addr()?;
        let task = tokio::spawn(listen(listener, content, Arc::new(page)));
        Ok(Self { address, task })
    }
}

async fn listen<F>(
    listener: TcpListener,
    content: &'static str,
    page: Arc<impl Fn() -> F + Send + Sync + 'static>,
) where
    F: Future<Output = String> + Send + 'static,
{
    let places = Arc::new(Semaphore::new(CALLERS));
    // callers go when the door does
    let mut callers = JoinSet::new();
    loop {
        while callers.try_join_next().is_some() {}
        let Ok((stream, _)) = listener.accept().await else {
            // no descriptors: a moment later there may be some
            tokio::time::sleep(Duration::from_millis(100)).await;
            continue;
        };
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
            continue;
        };
        let page = Arc::clone(&page);
        callers.spawn(async move {
            let _place = place;
            let _ = tokio::time::timeout(PATIENCE, talk(stream, content, page.as_ref())).await;
        });
    }
}

/// One question, one answer.
async fn talk<S, F>(
    mut stream: S,
    content: &'static str,
    page: &(impl Fn() -> F + Sync),
) -> std::io::Result<()>
where
    S: AsyncRead + AsyncWrite + Unpin,
    F: Future<Output = String>,
{
    let head = head(&mut stream).await?;
    let (bodiless, answer) = match head.as_deref().map(question) {
        None => (
            false,
            Answer::refusal("431 Request Header Fields Too Large"),
        ),
        Some(Err(status)) => (false, Answer::refusal(status)),
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

/// What is asked; the headers say nothing that matters here.
fn question(head: &[u8]) -> Result<Method, &'static str> {
    const BAD: &str = "400 Bad Request";
    let head = std::str::from_utf8(head).map_err(|_| BAD)?;
    let line = head.split("\r\n").next().unwrap_or_default();
    let words: Vec<&str> = line.split(' ').collect();
    let [method, target, version] = words[..] else {
        return Err(BAD);
    };
    if !matches!(version, "HTTP/1.1" | "HTTP/1.0") {
        return Err(BAD);
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

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::DuplexStream;
    use tokio::net::TcpStream;

    const DEADLINE: Duration = Duration::from_secs(120);

    async fn ask(request: &[u8]) -> String {
        let (mut caller, stream): (DuplexStream, _) = tokio::io::duplex(64 * 1024);
        caller.write_all(request).await.unwrap();
        let page = || async { "tactus_well 1\n# EOF\n".to_owned() };
        let _ = talk(stream, "text/x", &page).await;
        let mut answer = Vec::new();
        caller.read_to_end(&mut answer).await.unwrap();
        String::from_utf8(answer).unwrap()
    }

    #[tokio::test]
    async fn one_page_is_served_and_nothing_else() {
        let answer = ask(b"GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n").await;
        assert!(answer.starts_with("HTTP/1.1 200 OK\r\nContent-Type: text/x\r\n"));
        assert!(
            answer.ends_with("\r\n\r\ntactus_well 1\n# EOF\n"),
            "{answer}"
        );
        let answer = ask(b"HEAD /metrics?a=b HTTP/1.0\r\n\r\n").await;
        assert!(answer.contains("Content-Length: 20") && answer.ends_with("\r\n\r\n"));
        for (request, status) in [
            (&b"GET / HTTP/1.1\r\n\r\n"[..], "404"),
            (b"GET /metrics/../etc HTTP/1.1\r\n\r\n", "404"),
            (b"POST /metrics HTTP/1.1\r\n\r\n", "405"),
            (b"GET /metrics HTTP/9\r\n\r\n", "400"),
            (b"GET /metrics\r\n\r\n", "400"),
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

    /// Callers that say nothing take every place, and give it back when their time is over.
    #[tokio::test]
    async fn silent_callers_are_bounded_in_number_and_time() {
        let local = SocketAddr::from(([127, 0, 0, 1], 0));
        let page = || async { "page".to_owned() };
        let door = Door::open(local, "text/x", page).await.unwrap();
        let mut silent = Vec::new();
        for _ in 0..CALLERS {
            let mut caller = TcpStream::connect(door.address).await.unwrap();
            caller.write_all(b"GET /met").await.unwrap();
            silent.push(caller);
        }
        // places are taken in the order of connections, so the next one finds none
        let mut late = TcpStream::connect(door.address).await.unwrap();
        let mut answer = Vec::new();
        let hung_up = tokio::time::timeout(DEADLINE, late.read_to_end(&mut answer)).await;
        let _ = hung_up.unwrap();
        assert!(answer.is_empty());
        for mut caller in silent {
            let mut answer = Vec::new();
            let over = tokio::time::timeout(DEADLINE, caller.read_to_end(&mut answer)).await;
            let _ = over.unwrap();
            assert!(answer.is_empty());
        }
        // a place is free a moment after its caller was hung up on
        let answered = async {
            loop {
                let mut caller = TcpStream::connect(door.address).await.unwrap();
                let mut answer = Vec::new();
                let request = b"GET /metrics HTTP/1.1\r\n\r\n";
                if caller.write_all(request).await.is_ok()
                    && caller.read_to_end(&mut answer).await.is_ok()
                    && !answer.is_empty()
                {
                    return answer;
                }
            }
        };
        let answer = tokio::time::timeout(DEADLINE, answered).await.unwrap();
        assert!(answer.starts_with(b"HTTP/1.1 200"));
    }
}
