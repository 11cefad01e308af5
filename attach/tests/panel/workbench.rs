//! The panel with all that it can do, as a person uses it, in light and dark, on a screen and on a phone.

use std::path::Path;

use serde_json::Value;

use super::{JOG_BUTTON, Result, browser::Browser, machine::Machine, network::Cable, opened};

/// The page of a large screen, and of a phone.
const SCREEN: (u32, u32) = (1400, 1000);
const PHONE: (u32, u32) = (390, 844);
/// The height of a card of an axis on a screen, in pixels: two rows of them leave room for the scope.
const CARD: f64 = 175.0;

pub(crate) fn run(pictures: &Path) -> Result<()> {
    let machine = Machine::with_all_grants()?;
    let cable = Cable::lay(machine.port()?)?;
    let browser = opened(&machine, &cable)?;
    browser.resize(SCREEN.0, SCREEN.1, false)?;
    browser.theme("light")?;
    cards_are_small_and_the_scope_is_in_view(&browser)?;
    all_axes_are_enabled_by_one_button(&browser)?;
    a_move_is_commanded_and_followed(&browser)?;
    browser.run("scrollTo(0, 0)")?;
    browser.picture(&pictures.join("panel.png"))?;
    signals_are_chosen_and_a_wrong_name_is_refused(&browser)?;
    cursors_show_values_and_the_difference(&browser)?;
    browser.picture_of("#scope-section", &pictures.join("scope.png"))?;
    noise_stays_small_and_the_height_is_dragged(&browser)?;
    bits_are_named_by_the_mode(&browser)?;
    every_device_is_shown(&browser, &machine)?;
    browser.picture_of("#line-section", &pictures.join("line.png"))?;
    objects_are_read_as_they_are_shown_and_edited_in_place(&browser)?;
    browser.picture_of("#objects-section", &pictures.join("objects.png"))?;
    a_fault_is_reset(&browser, &machine)?;
    a_lost_drive_is_recovered(&browser, &machine, pictures)?;
    commands_are_listed_with_their_ends(&browser)?;
    histograms_have_axes(&browser)?;
    the_theme_changes_without_a_reload(&browser, pictures)?;
    it_is_used_on_a_phone(&browser, pictures)?;
    drop(browser);
    machine.end()
}

/// What a script says, in place of a picture.
fn number(browser: &Browser, script: &str) -> Result<f64> {
    let said = browser.run(script)?;
    said.as_f64()
        .ok_or_else(|| format!("{script} gives {said}").into())
}

fn expect(holds: bool, what: &str, found: impl std::fmt::Display) -> Result<()> {
    match holds {
        true => Ok(()),
        false => Err(format!("{what}: {found}").into()),
    }
}

fn height(browser: &Browser, css: &str) -> Result<f64> {
    number(
        browser,
        &format!("return document.querySelector('{css}').getBoundingClientRect().height"),
    )
}

fn is(browser: &Browser, what: &str, css: &str, text: &str) -> Result<()> {
    browser.wait(
        what,
        &format!("return document.querySelector(\"{css}\")?.textContent === '{text}'"),
    )
}

fn cards_are_small_and_the_scope_is_in_view(browser: &Browser) -> Result<()> {
    let card = height(browser, ".card[data-axis=x]")?;
    expect(card <= CARD, "a card is as high as", card)?;
    browser.wait(
        "the plot is in view without scrolling",
        "const plot = document.querySelector('#scope canvas')?.getBoundingClientRect(); \
         return plot !== undefined && plot.height > 200 && plot.bottom <= innerHeight",
    )?;
    browser.wait(
        "the last values are there without a cursor",
        "return document.querySelector('#values tr[data-signal=\"x.position\"] .now')?.textContent !== ''",
    )
}

fn all_axes_are_enabled_by_one_button(browser: &Browser) -> Result<()> {
    is(
        browser,
        "y is disabled",
        ".card[data-axis=y] .state",
        "disabled",
    )?;
    browser.click("#enable-all")?;
    for axis in ["x", "y"] {
        let css = format!(".card[data-axis={axis}] .state");
        is(browser, "the axis is enabled", &css, "enabled")?;
    }
    Ok(())
}

/// By its fields, with an acceleration.
fn a_move_is_commanded_and_followed(browser: &Browser) -> Result<()> {
    let field = |of: &str| format!(".card[data-axis=x] input[aria-label='{of} of x']");
    for (of, value) in [
        ("target", "40"),
        ("velocity of the move", "25"),
        ("acceleration of the move", "250"),
    ] {
        browser.fill(&field(of), value)?;
    }
    browser.click(".card[data-axis=x] .go")?;
    browser.wait(
        "x moves, with a bar and its target",
        "const card = document.querySelector('.card[data-axis=x]'); \
         const done = Number(card.querySelector('.bar').getAttribute('aria-valuenow')); \
         return !card.querySelector('.moving').hidden && card.querySelector('.bar.busy') !== null && done > 10 && done < 95 \
             && card.querySelector('.readings').textContent.includes('40.000 mm')",
    )?;
    browser.wait(
        "it has come to its target",
        "const card = document.querySelector('.card[data-axis=x]'); \
         return card.querySelector('.moving').hidden \
             && Math.abs(parseFloat(card.querySelector('.large .value').textContent) - 40) < 0.1",
    )?;
    // From there by a distance: the target is shown, not the distance.
    browser.run(
        "const way = document.querySelector('.card[data-axis=x] .move select'); \
         way.value = 'by'",
    )?;
    browser.fill(&field("target"), "-10")?;
    browser.click(".card[data-axis=x] .go")?;
    browser.wait(
        "it has gone by a distance",
        "const card = document.querySelector('.card[data-axis=x]'); \
         const target = parseFloat(card.querySelectorAll('.reading .value')[2].textContent); \
         return Math.abs(target - 30) < 0.1 && card.querySelector('.moving').hidden \
             && Math.abs(parseFloat(card.querySelector('.large .value').textContent) - 30) < 0.1",
    )
}

fn signals_are_chosen_and_a_wrong_name_is_refused(browser: &Browser) -> Result<()> {
    browser.click("#picker summary")?;
    browser.fill("#signal", "x.foll")?;
    browser.wait(
        "the list is what fits",
        "return document.querySelectorAll('#signal-list li').length === 1",
    )?;
    let count = "return scope.columns[0].length";
    let before = browser.with("signals.js", "scope", count)?;
    browser.click("#signal-list input")?;
    browser.wait(
        "what was chosen is shown",
        "return Boolean(document.querySelector('#values tr[data-signal=\"x.following_error\"] .now')?.textContent)",
    )?;
    let kept = browser.with("signals.js", "scope", count)?;
    expect(
        kept.as_u64() >= before.as_u64(),
        "what was seen before is gone",
        &kept,
    )?;
    browser.fill("#signal", "x.positon")?;
    browser.type_into("#signal", "\u{E007}")?;
    browser.wait(
        "the reason is told",
        "return document.querySelector('#signal-error').textContent.includes('positon')",
    )?;
    let kept = kept.as_u64().unwrap_or_default();
    browser.wait_with(
        "the stream goes on",
        "signals.js",
        "scope",
        &format!("return scope.signals.length === 3 && scope.columns[0].length > {kept} + 100"),
    )?;
    browser.fill("#signal", "6077h@0")?;
    browser.click("#add-signal")?;
    browser.wait_with(
        "a name that is not in the list is shown",
        "signals.js",
        "scope",
        "return scope.signals.includes('6077h:00@0')",
    )?;
    browser.click("[aria-label='remove 6077h:00@0']")?;
    browser.click("[aria-label='remove x.following_error']")?;
    browser
        .run("document.querySelector('#picker').open = false")
        .map(drop)
}

fn cursors_show_values_and_the_difference(browser: &Browser) -> Result<()> {
    // Something to measure.
    browser.run("document.querySelector('.card[data-axis=x] .move select').value = 'to'")?;
    browser.fill(".card[data-axis=x] input[aria-label='target of x']", "0")?;
    browser.click(".card[data-axis=x] .go")?;
    browser.wait(
        "x stands at 0",
        "const card = document.querySelector('.card[data-axis=x]'); \
         return card.querySelector('.moving').hidden && Math.abs(parseFloat(card.querySelector('.large .value').textContent.replace('−', '-'))) < 0.1",
    )?;
    browser.wait_with(
        "the move is in the window",
        "signals.js",
        "scope",
        "return scope.columns[0].at(-1) - scope.columns[0][0] > 2.5",
    )?;
    browser.click("#run")?;
    browser.click("#cursors")?;
    let values = "const row = document.querySelector('#values tr[data-signal=\"x.position\"]'); \
                  return ['at-a', 'at-b', 'between'].map((name) => parseFloat(row.querySelector(`.${name}`).textContent.replace('−', '-')))";
    browser.wait(
        "both cursors have values",
        "return document.querySelector('#values .between').textContent !== ''",
    )?;
    let seen = |value: &Value, at: usize| value[at].as_f64().unwrap_or(f64::NAN);
    let first = browser.run(values)?;
    let wrong = seen(&first, 1) - seen(&first, 0) - seen(&first, 2);
    expect(wrong.abs() < 1e-3, "the difference of the cursors", &first)?;
    let time = "return parseFloat(document.querySelector('#time-a').textContent)";
    let before = number(browser, time)?;
    browser.drag(".cursor-line", 120, 0)?;
    let after = number(browser, time)?;
    expect(after > before, "the cursor is dragged to", after)
}

fn noise_stays_small_and_the_height_is_dragged(browser: &Browser) -> Result<()> {
    browser.click("#cursors")?;
    browser.click("#run")?;
    browser.wait_with(
        "an axis that stands has a scale of some counts",
        "signals.js",
        "scope",
        "const { min, max } = scope.plot.scales['unit mm/s']; \
         const shown = scope.columns[2].slice(-500); \
         const noise = Math.max(...shown) - Math.min(...shown); \
         return scope.runs && noise < 1 && max - min >= 5",
    )?;
    let before = height(browser, "#scope canvas")?;
    browser.drag("#scope-handle", 0, 80)?;
    let after = height(browser, "#scope canvas")?;
    let grown = (after - before - 80.0).abs() < 2.0;
    expect(grown, "the scope is dragged by 80 to", after)?;
    browser.drag("#scope-handle", 0, -80)
}

/// Bit 12 is another one in each mode.
fn bits_are_named_by_the_mode(browser: &Browser) -> Result<()> {
    let shows = |what: &str, text: &str| {
        browser.wait(
            what,
            &format!(
                "return document.querySelector('.card[data-axis=x] .words').textContent.includes('{text}')"
            ),
        )
    };
    browser.wait(
        "the words are behind a click",
        "return document.querySelector('.card[data-axis=x] .words').hidden",
    )?;
    browser.click(".card[data-axis=x] .words-button")?;
    shows("mode 1", "12 set-point acknowledge")?;
    browser.hold(JOG_BUTTON)?;
    browser.wait(
        "x is jogged, which is moving",
        "const card = document.querySelector('.card[data-axis=x]'); \
         return card.querySelector('.mode').textContent.startsWith('profile velocity') && !card.querySelector('.moving').hidden",
    )?;
    shows("mode 3", "12 speed is 0")?;
    browser.release()?;
    browser.wait(
        "x stands",
        "return document.querySelector('.card[data-axis=x] .moving').hidden",
    )?;
    browser.click(".card[data-axis=x] .home button")?;
    shows("mode 6", "12 homing attained")?;
    browser.wait(
        "the homing is in the log",
        "return document.querySelector('#commands').textContent.includes('homed at')",
    )?;
    browser.click(".card[data-axis=x] .words-button")
}

fn every_device_is_shown(browser: &Browser, machine: &Machine) -> Result<()> {
    browser.wait(
        "all devices have a state, the one too that nobody has declared",
        "const rows = [...document.querySelectorAll('#line > li')].map((row) => row.querySelector('.pill').textContent); \
         return rows.length === 4 && rows.slice(0, 3).every((state) => state === 'OP') && rows[3] !== 'OP' && rows[3] !== 'no answer'",
    )?;
    browser.wait(
        "the ports are told of",
        "return [...document.querySelectorAll('#line .ports')].every((ports) => ports.textContent === 'no port errors')",
    )?;
    machine.press_buttons();
    browser.wait(
        "the inputs are shown",
        "const values = [...document.querySelectorAll('#line li[data-position=\"1\"] .points .number')].map((cell) => cell.textContent); \
         return values.length === 8 && values[0] === '1 on' && values[1] === '0 off' && values[2] === '1 on'",
    )?;
    browser.click("#line li[data-position='0'] button")?;
    browser.wait(
        "what the drive exchanges is shown too",
        "return [...document.querySelectorAll('#line li[data-position=\"0\"] tr')].some((row) => row.textContent.includes('x.position') && row.querySelector('.number').textContent !== '')",
    )?;
    browser.click("#line li[data-position='0'] button")
}

fn objects_are_read_as_they_are_shown_and_edited_in_place(browser: &Browser) -> Result<()> {
    browser.run("document.querySelector('#objects-section').scrollIntoView()")?;
    browser.wait(
        "the objects are listed and the first are read",
        "const rows = document.querySelectorAll('#objects tr'); \
         return rows.length > 50 && /[0-9A-F]h$/.test(rows[0].querySelector('.value').textContent)",
    )?;
    browser.wait(
        "none that is out of view is read",
        "return [...document.querySelectorAll('#objects tr')].at(-1).querySelector('.value').textContent === '…'",
    )?;
    browser.fill("#filter", "following error")?;
    browser.wait(
        "the list is what was typed",
        "const names = [...document.querySelectorAll('#objects tr td:nth-child(2)')].map((cell) => cell.textContent.toLowerCase()); \
         return names.length > 1 && names.length < 20 && names.every((name) => name.includes('following error'))",
    )?;
    browser.fill("#filter", "6066")?;
    let value = "#objects tr[data-object='6066h:00'] .value";
    browser.wait(
        "the object is read",
        &format!("return document.querySelector(\"{value}\")?.textContent.endsWith('h') === true"),
    )?;
    browser.click("[aria-label='edit 6066h:00']")?;
    browser.fill("[aria-label='value for 6066h:00']", "70000")?;
    browser.type_into("[aria-label='value for 6066h:00']", "\u{E007}")?;
    browser.wait(
        "what the type does not hold is refused",
        "return document.querySelector('#message').textContent.includes('is no UNSIGNED16')",
    )?;
    browser.fill("[aria-label='value for 6066h:00']", "1234")?;
    browser.type_into("[aria-label='value for 6066h:00']", "\u{E007}")?;
    is(browser, "it is written and read back", value, "1234 4D2h")?;
    browser.fill("#filter", "6040h:00")?;
    browser.wait(
        "what the library writes is not offered",
        "return document.querySelectorAll('#objects tr').length === 1 && document.querySelector('#objects button') === null",
    )?;
    browser.fill("#filter", "60")
}

fn a_fault_is_reset(browser: &Browser, machine: &Machine) -> Result<()> {
    machine.fault_of_y();
    browser.wait(
        "the card is red and says why",
        "const card = document.querySelector('.card[data-axis=y]'); \
         return card.classList.contains('bad') && card.querySelector('.state').textContent === 'fault' \
             && card.querySelector('.why').textContent.includes('8611h') && card.querySelector('.recover').hidden",
    )?;
    is(browser, "the head names it", "#connection", "fault: y")?;
    browser.click(".card[data-axis=y] .reset")?;
    is(
        browser,
        "the fault is gone",
        ".card[data-axis=y] .state",
        "disabled",
    )?;
    is(browser, "and from the head", "#connection", "connected")
}

fn a_lost_drive_is_recovered(browser: &Browser, machine: &Machine, pictures: &Path) -> Result<()> {
    machine.drive_leaves_op();
    browser.wait(
        "the cards are red and say why",
        "return ['x', 'y'].every((axis) => { \
             const card = document.querySelector(`.card[data-axis=${axis}]`); \
             return card.classList.contains('bad') && card.querySelector('.state').textContent === 'lost' \
                 && card.querySelector('.why').textContent.includes('SAFEOP'); \
         })",
    )?;
    browser.wait(
        "the head says that the line is lost",
        "return document.querySelector('#connection').textContent.startsWith('line lost')",
    )?;
    browser.wait(
        "so does the line",
        "return document.querySelector('#line li[data-position=\"0\"] .pill').classList.contains('bad')",
    )?;
    browser.run("scrollTo(0, 0)")?;
    browser.picture(&pictures.join("lost.png"))?;
    browser.theme("dark")?;
    browser.picture(&pictures.join("lost-dark.png"))?;
    browser.theme("light")?;
    browser.click(".card[data-axis=x] .recover")?;
    browser.wait(
        "the drive is back",
        "return ['x', 'y'].every((axis) => !document.querySelector(`.card[data-axis=${axis}]`).classList.contains('bad'))",
    )
    .or_else(|_| {
        // The watchdog may have left a fault, which is reset.
        browser.run("document.querySelectorAll('.card .reset:not([hidden])').forEach((button) => button.click())")?;
        browser.wait(
            "the drive is back without a fault",
            "return document.querySelectorAll('.card.bad').length === 0",
        )
    })?;
    is(browser, "the line is back", "#connection", "connected")?;
    browser.wait(
        "its device is in OP",
        "return document.querySelector('#line li[data-position=\"0\"] .pill').textContent === 'OP'",
    )
}

fn commands_are_listed_with_their_ends(browser: &Browser) -> Result<()> {
    browser.click(".card[data-axis=x] .stop")?;
    browser.click("#enable-all")?;
    for axis in ["x", "y"] {
        let css = format!(".card[data-axis={axis}] .state");
        is(browser, "the axis is enabled again", &css, "enabled")?;
    }
    for (what, ended) in [
        ("stop x", "sent in the next frame"),
        ("enable all axes", "axes are enabled"),
        ("move x to 40 mm with 25 mm/s", "reached "),
        ("jog x with 20 mm/s", "released"),
        ("write 6066h", "written"),
        ("reset the fault of y", "reset"),
        ("recover the drive of x", ""),
    ] {
        browser.wait(
            &format!("`{what}` is in the log"),
            &format!(
                "return [...document.querySelectorAll('#commands tr')].some((row) => row.textContent.includes('{what}') \
                     && row.querySelector('.outcome').textContent.includes('{ended}') \
                     && row.querySelector('.outcome.good') !== null && row.querySelector('.who').textContent.includes('with the token'))"
            ),
        )?;
    }
    Ok(())
}

fn histograms_have_axes(browser: &Browser) -> Result<()> {
    browser.wait(
        "the bars have a scale of times with units, and one of cycles",
        "return ['lateness', 'round trip'].every((name, place) => { \
             const plot = document.querySelectorAll('#histograms svg')[place]; \
             const texts = [...(plot?.querySelectorAll('text') ?? [])].map((text) => text.textContent); \
             return texts.some((text) => /^\\d+ (ns|µs|ms)$/.test(text)) && texts.includes('cycles') && texts.includes('10') \
                 && texts.some((text) => text.startsWith(name)) && plot.querySelectorAll('.column').length > 1; \
         })",
    )
}

/// Whether this colour, of red, green and blue, is on the canvas of the scope.
fn has_colour(browser: &Browser, what: &str, colour: [u8; 3]) -> Result<()> {
    let [red, green, blue] = colour;
    browser.wait(
        what,
        &format!(
            "const canvas = document.querySelector('#scope canvas'); \
             const {{ data }} = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height); \
             for (let at = 0; at < data.length; at += 4) \
                 if (data[at] === {red} && data[at + 1] === {green} && data[at + 2] === {blue} && data[at + 3] === 255) return true; \
             return false"
        ),
    )
}

fn the_theme_changes_without_a_reload(browser: &Browser, pictures: &Path) -> Result<()> {
    browser.run("window.isTheSame = true; scrollTo(0, 0)")?;
    has_colour(browser, "the scope is light", [0x0b, 0x62, 0xc4])?;
    browser.theme("dark")?;
    has_colour(browser, "the scope is dark", [0x6a, 0xae, 0xff])?;
    browser.wait(
        "the page is dark, and the same",
        "return window.isTheSame === true && getComputedStyle(document.body).backgroundColor === 'rgb(17, 20, 24)'",
    )?;
    browser.fill(".card[data-axis=x] input[aria-label='target of x']", "40")?;
    browser.click(".card[data-axis=x] .go")?;
    browser.run("scrollTo(0, 0)")?;
    browser.wait(
        "x is on its way",
        "return Number(document.querySelector('.card[data-axis=x] .bar').getAttribute('aria-valuenow')) > 40",
    )?;
    browser.picture(&pictures.join("panel-dark.png"))?;
    // By its button: as the computer has it, light, dark.
    browser.click("#theme")?;
    has_colour(browser, "light was chosen", [0x0b, 0x62, 0xc4])?;
    browser.click("#theme")?;
    browser.click("#theme")?;
    has_colour(browser, "it is as the computer has it", [0x6a, 0xae, 0xff])?;
    browser.theme("light")?;
    has_colour(browser, "it is light again", [0x0b, 0x62, 0xc4])
}

fn it_is_used_on_a_phone(browser: &Browser, pictures: &Path) -> Result<()> {
    browser.resize(PHONE.0, PHONE.1, true)?;
    let head = height(browser, ".page-head")?;
    let is_low = (head - 64.0).abs() < 0.5;
    expect(is_low, "the head is as high as", head)?;
    browser.wait(
        "no key is named, and nothing is wider than the screen",
        "return getComputedStyle(document.querySelector('#quick-stop .wide-only')).display === 'none' \
             && document.documentElement.scrollWidth <= innerWidth && innerWidth === 390",
    )?;
    browser.run("scrollTo(0, 0)")?;
    browser.picture(&pictures.join("panel-phone.png"))?;
    for part in ["objects", "log", "scope"] {
        browser.click(&format!("nav a[href='#{part}-section']"))?;
        browser.wait(
            "the link leads there",
            &format!(
                "const {{ top }} = document.querySelector('#{part}-section').getBoundingClientRect(); \
                 return top >= 60 && top < 200"
            ),
        )?;
        browser.picture(&pictures.join(format!("phone-{part}.png")))?;
    }
    browser.wait(
        "the token is still in the address",
        "return location.hash.startsWith('#token=')",
    )
}
