"""The look of the page: light and dark by the reader's setting, and on paper."""

CSS = """
:root{color-scheme:light dark;--ink:#1f2328;--soft:#57606a;--line:#d8dee4;--page:#ffffff;--card:#f6f8fa;
--accent:#1f6feb;--warn:#7a3e00;--warnback:#fff4e0;--warnline:#e2a146}
@media (prefers-color-scheme:dark){:root{--ink:#e6edf3;--soft:#a5afba;--line:#30363d;--page:#0d1117;--card:#161b22;
--accent:#79b8ff;--warn:#ffd9a0;--warnback:#2b1f0b;--warnline:#9a6a1b}}
*{box-sizing:border-box}
html{scroll-behavior:smooth}
body{margin:0;background:var(--page);color:var(--ink);
font:16px/1.55 system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif}
main,header,footer{max-width:72rem;margin:0 auto;padding:0 1.5rem}
header{padding-top:2.5rem;display:flex;gap:2rem;align-items:flex-start;justify-content:space-between}
h1{font-size:2rem;line-height:1.2;margin:0 0 .4rem;letter-spacing:-.01em}
h2{font-size:1.3rem;margin:3rem 0 .75rem;padding-bottom:.35rem;border-bottom:1px solid var(--line)}
h3{font-size:1rem;margin:0 0 .5rem}
p{margin:.4rem 0 .8rem;max-width:60rem}
a{color:var(--accent)}
a:focus-visible,[tabindex]:focus-visible{outline:3px solid var(--accent);outline-offset:2px}
.soft{color:var(--soft)}
.skip{position:absolute;left:-999rem;background:var(--page);padding:.5rem 1rem;z-index:1}
.skip:focus{left:1rem;top:1rem}
nav ul{list-style:none;display:flex;flex-wrap:wrap;gap:.3rem 1.2rem;padding:0;margin:1rem 0 0;font-size:.93rem}
.painting{flex:none;margin:0;width:9rem}
.painting figcaption{font-size:.8rem}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(10.5rem,1fr));gap:.75rem;margin:1.75rem 0 0;padding:0;
list-style:none}
.tiles li{background:var(--card);border:1px solid var(--line);border-radius:.6rem;padding:.8rem 1rem;display:flex;
flex-direction:column}
.tiles .label{order:-1;font-size:.85rem;color:var(--soft)}
.tiles .value{font-size:1.55rem;font-weight:650;line-height:1.25;font-variant-numeric:tabular-nums}
.tiles .unit{font-size:.9rem;font-weight:400;color:var(--soft)}
.tiles .note{font-size:.8rem;color:var(--soft)}
.warnings{background:var(--warnback);border:1px solid var(--warnline);border-left-width:.35rem;color:var(--warn);
border-radius:.4rem;padding:.7rem 1.1rem;margin:1.5rem 0 0}
.warnings h2{font-size:1rem;border:0;margin:0;padding:0}
.warnings ul{margin:.3rem 0 0;padding-left:1.2rem}
.sheet{margin:0 0 1.75rem;break-inside:avoid}
.row{display:grid;grid-template-columns:repeat(var(--columns,4),minmax(0,1fr));gap:.6rem}
figure{margin:0}
figure img{display:block;width:100%;height:auto;border-radius:.3rem;background:var(--card)}
figcaption{font-size:.85rem;color:var(--soft);margin-top:.25rem}
.legends{display:flex;flex-wrap:wrap;gap:.5rem 2.5rem;margin:0 0 1.2rem;padding:0;list-style:none;font-size:.85rem;
color:var(--soft)}
.legends li{display:flex;align-items:center;gap:.5rem}
.bar{width:9rem;height:.75rem;border-radius:.2rem;border:1px solid var(--line);-webkit-print-color-adjust:exact;
print-color-adjust:exact}
.wide{overflow-x:auto}
table{border-collapse:collapse;width:100%;font-size:.92rem}
caption{text-align:left;color:var(--soft);font-size:.88rem;padding-bottom:.4rem}
th,td{text-align:left;padding:.42rem .8rem .42rem 0;border-bottom:1px solid var(--line);vertical-align:top}
thead th{font-size:.85rem;color:var(--soft);font-weight:600;border-bottom-width:2px;vertical-align:bottom}
tbody th{font-weight:600;min-width:9rem}
table.dense{font-size:.86rem}
table.dense thead th{white-space:normal;vertical-align:bottom;font-size:.78rem;min-width:4.2rem}
table.dense tbody th{min-width:6rem}
td.number,th.number{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
td.protocol{color:var(--soft);font-size:.84rem;min-width:17rem;width:48%}
td.mean{font-weight:650}
tr.marked td,tr.marked th{background:var(--warnback)}
.chart{margin:1rem 0 2rem;max-width:56rem;break-inside:avoid}
.chart svg{display:block;width:100%;height:auto;color:var(--ink)}
dl.notes{margin:0}
dl.notes dt{font-weight:600;margin-top:.7rem}
dl.notes dd{margin:0;color:var(--soft);max-width:60rem}
footer{margin-top:3rem;padding-bottom:3rem;color:var(--soft);font-size:.85rem}
@media (max-width:44rem){header{display:block}.painting{margin-top:1rem}
.row{grid-template-columns:repeat(2,minmax(0,1fr))}main,header,footer{padding-left:1rem;padding-right:1rem}}
@media (prefers-reduced-motion:reduce){html{scroll-behavior:auto}}
@media print{:root{--ink:#000;--soft:#444;--line:#bbb;--page:#fff;--card:#fff;--accent:#000;--warn:#000;
--warnback:#fff;--warnline:#000}
body{font-size:10pt}nav,.skip{display:none}main,header,footer{max-width:none;padding:0}
h2{margin-top:1.5rem;break-after:avoid}tr{break-inside:avoid}.wide{overflow:visible}thead{display:table-header-group}}
"""
