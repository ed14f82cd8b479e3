use tokio::io::DuplexStream;
use tokio::net::TcpStream;

use super::*;

const PATIENCE: Duration = Duration::from_secs(120);

async fn metrics(path: String, _: SocketAddr) -> Result<Page, NoPage> {
    match path.as_str() {
        "/metrics" => Ok(Page {
            content: "text/x",
            body: "tactus_well 1\n# EOF\n".to_owned(),
        }),
        "/broken" => Err(NoPage::Failed),
        _ => Err(NoPage::NotFound),
    }
}

async fn ask(request: &[u8]) -> String {
    let (mut client, stream): (DuplexStream, _) = tokio::io::duplex(64 * 1024);
    client.write_all(request).await.unwrap();
    let hosts = Hosts::Own(vec!["rig.example".to_owned()]);
    let here = ([192, 0, 2, 7], 9617).into();
    answer_once(stream, here, &hosts, &metrics).await.ok();
    let mut answer = Vec::new();
    client.read_to_end(&mut answer).await.unwrap();
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
        (b"GET /broken HTTP/1.1\r\nHost: [::1]\r\n\r\n", "500"),
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
async fn any_host_and_none_is_answered_where_that_is_wanted() {
    for request in [
        &b"GET /metrics HTTP/1.1\r\n\r\n"[..],
        b"GET /metrics HTTP/1.1\r\nHost: other.example\r\n\r\n",
    ] {
        let (mut client, stream) = tokio::io::duplex(64 * 1024);
        client.write_all(request).await.unwrap();
        let here = ([192, 0, 2, 7], 80).into();
        answer_once(stream, here, &Hosts::Any, &metrics)
            .await
            .unwrap();
        let mut answer = String::new();
        client.read_to_string(&mut answer).await.unwrap();
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    }
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
async fn the_oldest_idle_clients_are_disconnected_for_new_ones() {
    let local = SocketAddr::from(([127, 0, 0, 1], 0));
    let hosts = Hosts::Own(Vec::new());
    let listener = HttpListener::open(local, hosts, metrics).await.unwrap();
    let silent = async |message: &[u8]| {
        let mut client = TcpStream::connect(listener.address()).await.unwrap();
        client.write_all(message).await.unwrap();
        client
    };
    let mut clients = Vec::new();
    for _ in 0..CLIENTS {
        clients.push(silent(b"GET /met").await);
    }
    // the two oldest connections are closed to accept these
    let mut late = silent(b"GET /metrics HTTP/1.0\r\n\r\n").await;
    clients.push(silent(b"").await);
    let mut answer = Vec::new();
    let answered = tokio::time::timeout(PATIENCE, late.read_to_end(&mut answer)).await;
    answered.unwrap().unwrap();
    assert!(answer.starts_with(b"HTTP/1.1 200"));
    for mut client in clients {
        let mut answer = Vec::new();
        let over = tokio::time::timeout(PATIENCE, client.read_to_end(&mut answer)).await;
        let _ = over.unwrap();
        assert!(answer.is_empty());
    }
}
