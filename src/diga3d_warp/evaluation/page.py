"""HTML page of the report: style, script and sections."""

from __future__ import annotations

from html import escape

STYLE = """
:root { color-scheme: light dark; --page: #f6f5f2; --card: #fff; --ink: #1d1c1a; --soft: #6b6963;
  --line: #e2e0da; --accent: #2a6fbb; --warn: #9a5b00 }
@media (prefers-color-scheme: dark) { :root { --page: #161616; --card: #212120; --ink: #efeeea;
  --soft: #a3a199; --line: #383733; --accent: #6ba6ea; --warn: #e0a14a } }
* { box-sizing: border-box }
body { margin: 0; background: var(--page); color: var(--ink); font: 15px/1.5 system-ui, sans-serif }
main { max-width: 1060px; margin: 0 auto; padding: 40px 20px 80px }
h1 { font-size: 30px; line-height: 1.2; margin: 0 0 6px; letter-spacing: -.02em }
h2 { font-size: 17px; margin: 44px 0 12px }
.soft, figcaption, caption { color: var(--soft) }
code, pre { font: 13px/1.5 ui-monospace, monospace; overflow-wrap: anywhere; white-space: pre-wrap }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); gap: 12px;
  margin: 26px 0 }
.tiles div, .card { background: var(--card); border: 1px solid var(--line); border-radius: 12px;
  padding: 14px 16px }
.tiles b { display: block; font-size: 22px; letter-spacing: -.01em }
.compare { position: relative; overflow: hidden; border-radius: 12px; background: #000; --cut: 50%;
  max-width: calc(72vh * var(--ratio)); margin: 0 auto }
.compare img { display: block; width: 100% }
.compare .before { position: absolute; inset: 0; height: 100%;
  clip-path: inset(0 calc(100% - var(--cut)) 0 0) }
.compare i { position: absolute; top: 0; bottom: 0; left: var(--cut); width: 2px; margin: 0 0 0 -1px;
  background: #fff; box-shadow: 0 0 6px #0008; pointer-events: none }
.compare i::after { content: "\\2194"; position: absolute; top: 50%; left: 1px; translate: -50% -50%;
  width: 36px; height: 36px; border-radius: 50%; background: #fff; color: #222; text-align: center;
  font: normal 20px/34px system-ui }
.compare input { position: absolute; inset: 0; width: 100%; height: 100%; margin: 0; opacity: 0;
  cursor: ew-resize }
.compare:focus-within { outline: 3px solid var(--accent) }
.compare span { position: absolute; top: 10px; padding: 2px 10px; border-radius: 99px; background: #000a;
  color: #fff; font-size: 13px; pointer-events: none }
.compare span.left { left: 10px }
.compare span.right { right: 10px }
.sheet { display: grid; grid-template-columns: repeat(auto-fill, minmax(130px, 1fr)); gap: 8px;
  margin-top: 10px }
.sheet button { padding: 0; border: 2px solid transparent; border-radius: 8px; background: none;
  cursor: pointer; overflow: hidden; color: var(--soft); font: 12px system-ui }
.sheet button[aria-pressed=true] { border-color: var(--accent); color: var(--ink) }
.sheet img { display: block; width: 100%; border-radius: 6px }
.sheet figure { margin: 0; font-size: 12px }
.scroll { overflow-x: auto; margin-bottom: 14px }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums }
caption { text-align: left; padding-bottom: 6px }
th, td { padding: 6px 10px; text-align: right; border-bottom: 1px solid var(--line); white-space: nowrap }
th { color: var(--soft); font-weight: 500 }
th.words, td.words { text-align: left; white-space: normal }
th:first-child, td:first-child { text-align: left; padding-left: 0 }
tr:last-child td { border-bottom: 0 }
.curves { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(320px, 100%), 1fr));
  gap: 12px }
.curves figure { margin: 0; background: var(--card); border: 1px solid var(--line); border-radius: 12px;
  padding: 14px 16px }
.curves b { color: var(--ink) }
.curve { width: 100%; overflow: visible }
.curve text { fill: var(--soft); font-size: 14px }
.curve .grid { stroke: var(--line) }
.curve circle { fill: var(--accent) }
.curve polyline { fill: none; stroke: var(--accent); stroke-width: 2; stroke-linejoin: round }
.stage { display: grid; grid-template-columns: minmax(90px, 170px) 1fr 92px 82px; gap: 12px;
  align-items: center; padding: 5px 0 }
.stage span:nth-child(n+3) { text-align: right; font-variant-numeric: tabular-nums }
.track { position: relative; height: 14px; border-radius: 4px; background: var(--line) }
.track i { position: absolute; height: 100%; min-width: 3px; border-radius: 4px;
  background: var(--accent) }
.notes li { color: var(--warn) }
@media (max-width: 560px) {
  .stage { grid-template-columns: 1fr 1fr 70px }
  .stage span:last-child { display: none }
}
"""

SCRIPT = """
const box = document.querySelector('.compare');
if (box) {
  const slider = box.querySelector('input');
  slider.addEventListener('input', () => box.style.setProperty('--cut', slider.value + '%'));
  for (const button of document.querySelectorAll('.sheet button')) button.addEventListener('click', () => {
    document.querySelector('.sheet [aria-pressed=true]').setAttribute('aria-pressed', 'false');
    button.setAttribute('aria-pressed', 'true');
    box.style.setProperty('--ratio', button.dataset.ratio);
    box.querySelector('.before').src = button.dataset.before;
    box.querySelector('.after').src = button.querySelector('img').src;
  });
}
"""


def page(title: str, sections: list[str]) -> str:
    """The whole page as HTML, with nothing to load from elsewhere.

    Args:
        title: Title of the page.
        sections: HTML, in order.
    """
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>\n"
        f"<body><main>\n{chr(10).join(sections)}\n</main><script>{SCRIPT}</script></body></html>\n"
    )


def section(title: str, content: str) -> str:
    """A headed section; nothing if it has no content."""
    return f"<section><h2>{escape(title)}</h2>\n{content}</section>" if content else ""
