//! Printable roundels, boards and code lists over REST.

use axum::http::StatusCode;

use super::rig::Rig;

#[tokio::test]
async fn serves_files_for_printing() {
    let rig = Rig::start().await;
    let pdf = rig.get("/api/v1/print?marker=160&code=8:2&ids=1-4").await;
    assert_eq!((pdf.status, pdf.header("content-type")), (StatusCode::OK, "application/pdf"));
    assert!(pdf.body.starts_with(b"%PDF-"));
    assert!(pdf.header("content-disposition").contains("roundels.pdf"));
    let svg = rig.get("/api/v1/print?marker=50:20&format=svg&page=Letter").await;
    assert_eq!((svg.status, svg.header("content-type")), (StatusCode::OK, "image/svg+xml"));
    assert!(svg.text().contains("width=\"215.9mm\""), "{}", svg.text());
    let board = rig.get("/api/v1/print?board=7x5&format=svg").await;
    assert!(board.text().contains("viewBox=\"0 0 297 210\""), "{}", board.text());
    let png = rig.get("/api/v1/print?marker=50:20&copies=3&format=png&dpi=72").await;
    assert_eq!((png.status, png.header("content-type")), (StatusCode::OK, "image/png"));
    assert!(png.body.starts_with(b"\x89PNG"));
    assert!(png.header("content-disposition").contains("roundels.png"));
    // Six roundels of 80 mm fill a page with two columns and three rows; a seventh needs another page.
    for (copies, last, is_there) in [(6, 1, true), (6, 2, false), (7, 2, true)] {
        let query = format!("marker=60:24&copies={copies}&format=svg&sheet={last}");
        let page = rig.get(&format!("/api/v1/print?{query}")).await;
        assert_eq!(page.status == StatusCode::OK, is_there, "{query}: {}", page.text());
    }
    let codes = rig.get("/api/v1/codes?code=8:2").await.json();
    assert_eq!((&codes[0]["number"], &codes[0]["word"]), (&1.into(), &"00000001".into()));
    rig.stop().await;
}

#[tokio::test]
async fn unprintable_requests_name_the_parameter() {
    let rig = Rig::start().await;
    for (query, expected) in [
        ("", "marker: expected OUTER_MM[:INNER_MM], or a board"),
        ("marker=160", "marker: expected OUTER_MM:INNER_MM for a plain roundel"),
        ("marker=big", "marker: expected OUTER_MM"),
        ("marker=160:20", "the detector finds no other"),
        ("marker=160&code=8:2&ids=0", "ids: expected numbers from 1 on"),
        ("marker=160&code=8:2&ids=99", "there is no code 99 of 8 bits"),
        ("marker=160:64&ids=1", "this kind has none"),
        ("marker=160&code=40", "code: expected codes of 2 to 16 bits"),
        ("marker=160:64&page=A9", "page: expected a page of A2"),
        ("marker=160:64&format=doc", "format: expected pdf, svg or png"),
        ("marker=50:20&format=svg&sheet=2", "sheet: expected a page from 1 to 1"),
        ("marker=160:64&copies=0", "copies: expected 1 to 1000"),
        ("marker=160:64&format=png&dpi=5", "dpi: "),
        ("marker=160:64&colour=red", "query: expected one of"),
        ("marker=160:64&polarity=grey", "polarity: "),
        ("board=7x5&copies=3", "copies: expected no such parameter for a board"),
        ("board=7x5&ids=3", "ids: expected no such parameter for a board"),
        ("marker=160:64&pitch=200", "pitch: expected `pitch` only with `board`"),
        ("marker=160:64&dpi=300", "dpi: expected `dpi` only with `format` png"),
        ("marker=160:64&sheet=2", "sheet: expected `sheet` only with `format` svg or png"),
        ("marker=160:64&copies=500", "query: expected at most 100 pages"),
        ("board=2x2", "board: expected a board of 3 to 40"),
        ("board=7x5&page=A5", "has room for"),
    ] {
        let answer = rig.get(&format!("/api/v1/print?{query}")).await;
        assert_eq!(answer.status, StatusCode::BAD_REQUEST, "{query}: {}", answer.text());
        let (code, message) = answer.error();
        assert_eq!(code, "invalid_argument");
        assert!(message.contains(expected), "{query}: {message}");
    }
    rig.stop().await;
}
