//! A real Chromium on the panel of a running, simulated machine: `cargo xtask panel-e2e`.
//!
//! The browser is in a network namespace of its own, behind a cable that is cut and a relay that delays. What the axis did is read from the
//! simulated drive.
#![allow(missing_docs)]

mod browser;
mod machine;
mod network;
mod workbench;

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::ExitCode,
    thread::sleep,
    time::{Duration, Instant},
};

use browser::Browser;
use machine::Machine;
use network::{Cable, relay};
use serde_json::{Value, json};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// It jogs `x` forward.
const JOG_BUTTON: &str = "button.jog[data-axis=x][data-direction='1']";

/// What ends a jog.
type End = fn(&Browser, &Cable) -> Result<()>;

/// How long anything may take to happen that has no time of its own.
const TIME: Duration = Duration::from_secs(20);
/// How long an axis may go on after what ends a jog: the dead-man time, a tick, the delay of a message, the ramp.
const STOPS: Duration = Duration::from_millis(1500);

fn main() -> ExitCode {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let done = match arguments
        .iter()
        .map(String::as_str)
        .collect::<Vec<_>>()
        .as_slice()
    {
        ["--relay", from, to] => relay(from, to),
        ["--run", pictures] => run(Path::new(pictures)),
        _ => {
            println!("the panel in a browser is tested by `cargo xtask panel-e2e`");
            Ok(())
        }
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("panel: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(pictures: &Path) -> Result<()> {
    fs::create_dir_all(pictures)?;
    workbench::run(pictures)?;
    let machine = Machine::start()?;
    let cable = Cable::lay(machine.port()?)?;
    let open = || opened(&machine, &cable);

    let browser = open()?;
    shows(&browser, &machine)?;
    a_move_is_seen(&browser, &machine)?;
    an_object_is_asked_for(&browser)?;
    values_are_of_their_types(&browser)?;
    a_write_asks_by_no_window(&browser)?;
    a_jog_goes_the_way_of_its_button(&browser, &machine)?;
    a_stop_waits_for_no_request(&browser)?;
    a_fault_is_seen(&browser, &machine)?;
    browser.picture_of("#events-section", &pictures.join("black-box.png"))?;
    browser.picture_of("#statistics-section", &pictures.join("cycles.png"))?;
    is_refused(&browser, &machine)?;

    let cases: [(&str, End); 9] = [
        ("released", |browser, _| browser.release()),
        ("quick stop by its key", |browser, _| {
            browser.key("\u{E00C}")
        }),
        ("focus lost", |browser, _| {
            browser.run("dispatchEvent(new Event('blur'))").map(drop)
        }),
        ("tab hidden", |browser, _| browser.hide()),
        ("browser stopped (SIGSTOP)", |browser, _| {
            browser.signal("STOP")
        }),
        ("cable cut", |_, cable| cable.cut()),
        ("messages late by 2 s", |_, cable| {
            cable.delay(Duration::from_secs(2));
            Ok(())
        }),
        ("page closed", |browser, _| browser.open("about:blank")),
        ("browser killed", |browser, _| browser.signal("KILL")),
    ];
    let mut browser = Some(browser);
    println!("{:<28} velocity 0 after", "a jog is held, and then");
    for (name, end) in cases {
        let used = match browser.take() {
            Some(browser) => browser,
            None => open()?,
        };
        machine.enable()?;
        let time =
            held_until(&used, &cable, &machine, end).map_err(|error| format!("{name}: {error}"))?;
        println!("{name:<28} {:>5} ms", time.as_millis());
        cable.mend()?;
        // What it did to the browser is not undone.
        drop(used);
    }
    machine.end()?;
    println!(
        "the panel does what it should; pictures in {}",
        pictures.display()
    );
    Ok(())
}

/// A browser with the panel of the machine, to which it is connected.
fn opened(machine: &Machine, cable: &Cable) -> Result<Browser> {
    let browser = Browser::start(cable)?;
    browser.open(machine.panel())?;
    browser.wait_with(
        "the panel is connected",
        "control.js",
        "tick",
        "return tick !== null && ['connected', 'fault: y'].includes(document.querySelector('#connection').textContent)",
    )?;
    Ok(browser)
}

/// Presses the button until the axis moves: right after a fault or a stop the page may be told that it cannot yet.
fn begin(browser: &Browser, machine: &Machine) -> Result<()> {
    for _ in 0..3 {
        browser.hold(JOG_BUTTON)?;
        let pressed = Instant::now();
        while pressed.elapsed() < Duration::from_secs(5) {
            if machine.speed() > 0.8 * machine::JOG {
                return Ok(());
            }
            sleep(Duration::from_millis(10));
        }
        browser.release()?;
    }
    let said = browser.run("return document.querySelector('#message').textContent")?;
    Err(format!("the axis does not move; the page says: {said}").into())
}

/// Holds the jog of `x`, lets this happen, and says how long the axis went on.
fn held_until(browser: &Browser, cable: &Cable, machine: &Machine, end: End) -> Result<Duration> {
    begin(browser, machine)?;
    let from = Instant::now();
    end(browser, cable)?;
    // What is late has come by then, and a stand has lasted for a second.
    sleep(cable.lateness() + STOPS + Duration::from_millis(1100));
    let stood = machine
        .stood_since(from)
        .ok_or_else(|| format!("the axis still moves after {STOPS:?}"))?;
    if stood > STOPS {
        return Err(format!("the axis stood only after {stood:?}").into());
    }
    Ok(stood)
}

fn until(what: &str, is_so: impl Fn() -> Result<bool>) -> Result<()> {
    let started = Instant::now();
    while !is_so()? {
        if started.elapsed() > TIME {
            return Err(format!("within {TIME:?} it has not come to this: {what}").into());
        }
        sleep(Duration::from_millis(10));
    }
    Ok(())
}

fn shows(browser: &Browser, machine: &Machine) -> Result<()> {
    machine.enable()?;
    browser.wait(
        "the line has its drive",
        "return document.querySelector('#line').textContent.includes('AKD2G')",
    )?;
    browser.wait(
        "both axes have cards",
        "return document.querySelectorAll('.card').length === 2",
    )?;
    browser.wait(
        "the state of x is shown",
        "return document.querySelector('.card[data-axis=x] .state')?.textContent === 'enabled'",
    )?;
    browser.click(".card[data-axis=x] .words-button")?;
    browser.wait(
        "its limits are shown",
        "return document.querySelector('.card[data-axis=x] .limits').textContent.startsWith('Limits: positions ')",
    )?;
    browser.wait(
        "and its following error",
        "return document.querySelector('.card[data-axis=x] .effort').textContent.startsWith('following error ')",
    )?;
    browser.wait(
        "the notice says what it is not",
        "return document.querySelector('.notice').textContent.includes('no safety function')",
    )
}

fn a_move_is_seen(browser: &Browser, machine: &Machine) -> Result<()> {
    let scope = |what, script| browser.wait_with(what, "signals.js", "scope", script);
    scope("the scope runs", "return scope.columns[0].length > 100")?;
    machine.moves_to(40.0)?;
    scope(
        "the move is in the scope",
        "const shown = scope.columns[1]; return Math.max(...shown) - Math.min(...shown) > 39",
    )?;
    let lost = browser.with("signals.js", "scope", "return scope.lost")?;
    println!("a move of 40 mm is in the scope; {lost} cycles lost");
    Ok(())
}

/// Index and subindex are hexadecimal, as the server reads them.
fn an_object_is_asked_for(browser: &Browser) -> Result<()> {
    let path = browser.with(
        "values.js",
        "objectPath",
        "return objectPath(3, {index: 0x1600, subindex: 16})",
    )?;
    if path.as_str() != Some("/v1/od/3/1600h/10") {
        return Err(format!("1600h:10 of drive 3 is asked for as {path}").into());
    }
    let differences = browser.with(
        "compare.js",
        "valuesOf, showDifferences",
        "const saved = await valuesOf(0, () => {}); \
         saved['6066h:00'].bytes = [57, 48]; \
         delete saved['6067h:00']; \
         showDifferences(saved, await valuesOf(0, () => {})); \
         return [...document.querySelectorAll('#differences tr')].map((row) => row.textContent).join('\\n');",
    )?;
    let differences = differences.as_str().unwrap_or_default();
    let has = |address: &str, value: &str| {
        let mut rows = differences.lines();
        rows.any(|row| row.starts_with(address) && row.contains(value))
    };
    match has("6066h:00", "12345") && has("6067h:00", "none") {
        true => Ok(()),
        false => Err(format!("the differences are {differences}").into()),
    }
}

/// What is shown and written is what the type holds; a number that would be cut is refused.
fn values_are_of_their_types(browser: &Browser) -> Result<()> {
    let said = browser.with(
        "values.js",
        "valueOf, bytesOf",
        "const is = (shown, expected) => { if (String(shown) !== expected) throw new Error(`${shown} is not ${expected}`); }; \
         const refused = (...of) => { let bytes; try { bytes = bytesOf(...of); } catch { return; } throw new Error(`${of} is ${bytes}`); }; \
         try { \
             is(valueOf([0, 0, 192, 63], 'REAL32'), '1.5'); \
             is(valueOf([205, 204, 204, 61], 'REAL32'), '0.1'); \
             is(valueOf([255, 255, 255], 'INTEGER24'), '-1'); \
             is(valueOf([255, 255], 'UNSIGNED16'), '65535'); \
             is(bytesOf('1.5', 'REAL32', 32), '0,0,192,63'); \
             is(bytesOf('-2', 'INTEGER16', 16), '254,255'); \
             is(bytesOf('0xFFFF', 'UNSIGNED16', 16), '255,255'); \
             is(bytesOf('12', 'VISIBLE_STRING', 64), '49,50'); \
             refused('', 'UNSIGNED32', 32); \
             refused('-1', 'UNSIGNED16', 16); \
             refused('40000', 'INTEGER16', 16); \
             refused('1e39', 'REAL32', 32); \
             refused('2', 'BOOLEAN', 1); \
             return 'so'; \
         } catch (error) { return error.message; }",
    )?;
    match said == "so" {
        true => Ok(()),
        false => Err(format!("a value on the page: {said}").into()),
    }
}

/// A window that asks for a value lets neither the button nor the key of the quick stop through.
fn a_write_asks_by_no_window(browser: &Browser) -> Result<()> {
    let asked = browser.with(
        "objects.js",
        "objectRow",
        "const own = window.prompt; \
         let asked = false; \
         window.prompt = () => { asked = true; return null; }; \
         const object = { index: 0x6072, subindex: 0, name: '', type: 'UNSIGNED16', bits: 16, access: 'rw' }; \
         const row = objectRow(0, object, { parameters: true, axes: [] }); \
         row.querySelector('button').click(); \
         row.querySelector('input').value = ''; \
         [...row.querySelectorAll('button')].find((button) => button.textContent === 'Write').click(); \
         window.prompt = own; \
         return asked ? 'a window asks' : document.querySelector('#message').textContent;",
    )?;
    match said_no_value(&asked) {
        true => Ok(()),
        false => Err(format!("a write without a value: {asked}").into()),
    }
}

fn said_no_value(said: &Value) -> bool {
    said.as_str()
        .is_some_and(|said| said.contains("is no UNSIGNED16"))
}

/// A sign that was typed does not turn the buttons around.
fn a_jog_goes_the_way_of_its_button(browser: &Browser, machine: &Machine) -> Result<()> {
    let field = "document.querySelector('.card[data-axis=x] input')";
    browser.run(&format!(
        "window.typed = {field}.value; {field}.value = '-5'"
    ))?;
    browser.hold(JOG_BUTTON)?;
    browser.wait(
        "a jog with -5 is refused",
        "return document.querySelector('#message').textContent.includes('above 0')",
    )?;
    browser.release()?;
    browser.run(&format!("{field}.value = window.typed"))?;
    match machine.speed() < 0.1 {
        true => Ok(()),
        false => Err("a jog with a negative number has moved the axis".into()),
    }
}

/// A browser lets a request wait until one of six others is answered, as those of moves are at their end. Here all of them wait until the
/// stop is answered.
fn a_stop_waits_for_no_request(browser: &Browser) -> Result<()> {
    for _ in 0..5 {
        browser.wait_with(
            "the WebSocket of the page is open",
            "control.js",
            "control",
            "return control?.readyState === WebSocket.OPEN",
        )?;
        let said = browser.with(
            "control.js",
            "control, stop",
            "const own = window.fetch; \
             const waiting = []; \
             window.fetch = (...request) => new Promise((answered, failed) => \
                 waiting.push(() => own(...request).then(answered, failed))); \
             const closed = new Promise((resolve) => control.addEventListener('close', resolve)) \
                 .then(() => ({closed: true})); \
             const stopped = stop('/v1/axes/y/stop', {stop: {axis: 'y'}}); \
             const answer = await Promise.race([stopped, closed]); \
             window.fetch = own; \
             waiting.forEach((go) => go()); \
             return answer;",
        )?;
        if said["asked"] == true {
            return Ok(());
        }
        // A page whose processor is taken away for long loses its WebSocket, and opens another.
        if said["closed"] != true {
            return Err(format!("a stop is answered by {said}").into());
        }
    }
    Err("no WebSocket of the page stays open for a stop".into())
}

fn a_fault_is_seen(browser: &Browser, machine: &Machine) -> Result<()> {
    machine.fault_of_y();
    browser.wait(
        "the fault of y is among the events",
        "return document.querySelector('#events').textContent.includes('axis y') \
         && document.querySelector('#events').textContent.includes('has a fault')",
    )?;
    browser.wait(
        "its emergency is listed",
        "return document.querySelector('#emergencies').textContent.includes('drive 0: ')",
    )?;
    browser.wait(
        "the cycles are in a histogram",
        "return document.querySelectorAll('#histograms figure:first-child .column').length > 1",
    )?;
    browser.run("document.querySelector('#events button').click()")?;
    browser.wait(
        "the black box is drawn, with its states",
        "return document.querySelector('#black-box canvas') !== null \
         && document.querySelector('#black-box ol').textContent.includes('Fault')",
    )
}

fn is_refused(browser: &Browser, machine: &Machine) -> Result<()> {
    let token = machine.token();
    // From the page itself: what is not granted.
    let refused = "const [path, body, done] = arguments; \
                   import(`${location.origin}/connection.js`).then(({ ask }) => ask(path, body)) \
                       .then(() => done('done'), (error) => done(error.message))";
    for (path, body) in [
        ("/v1/od/0/0x6066/0", json!({"bytes": [1, 0]})),
        ("/v1/axes/y/move", json!({"to": 1, "velocity": 1})),
        ("/v1/axes/y/enable", Value::Null),
        ("/v1/axes/x/recover", Value::Null),
    ] {
        let said = browser.run_async(refused, &json!([path, body]))?;
        if !said
            .as_str()
            .is_some_and(|said| said.contains("does not grant"))
        {
            return Err(format!("{path} was not refused: {said}").into());
        }
    }
    browser.with(
        "control.js",
        "control, tick",
        "control.send(JSON.stringify({ hold: { axis: 'y', velocity: 1, tick } }))",
    )?;
    browser.wait(
        "a jog of y is refused",
        "return document.querySelector('#message').textContent.includes('does not grant')",
    )?;
    // With a wrong token, and from a page of another origin with the right one.
    let origin = browser.run("return location.origin")?;
    let connects = "const [url, token, done] = arguments; \
                    const socket = new WebSocket(url, ['servocrab', `token.${token}`]); \
                    socket.onopen = () => done('open'); socket.onerror = () => done('refused')";
    let url = format!(
        "{}/v1/control",
        origin.as_str().unwrap_or_default().replace("http:", "ws:")
    );
    for (is_elsewhere, token, expected) in [
        (false, token, "open"),
        (false, "00000000000000000000000000000000", "refused"),
        (true, token, "refused"),
    ] {
        if is_elsewhere {
            browser.open("data:text/html,<p>a page from elsewhere</p>")?;
        }
        let said = browser.run_async(connects, &json!([url, token]))?;
        if said != expected {
            return Err(format!(
                "a WebSocket, from elsewhere: {is_elsewhere}, is {said} and not {expected}"
            )
            .into());
        }
    }
    browser.open(machine.panel())?;
    browser.wait(
        "the panel is back",
        "return ['connected', 'fault: y'].includes(document.querySelector('#connection')?.textContent)",
    )?;
    println!("refused: an edit, a move and a jog without a grant, a wrong token, another origin");
    Ok(())
}

/// Where this test's own executable is, for the relay in the namespace.
fn own_path() -> Result<PathBuf> {
    Ok(env::current_exe()?)
}
