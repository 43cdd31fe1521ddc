"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const find = id => document.getElementById(id);
  const store = "stylerf-votes-" + data.page;
  let votes = {}, at = 0, since = performance.now();

  // Where storage is blocked, votes last as long as the page is open.
  try { votes = JSON.parse(localStorage.getItem(store)) || {}; } catch (error) { votes = {}; }

  function show() {
    const done = at >= data.pairs.length, pair = data.pairs[Math.min(at, data.pairs.length - 1)];
    for (const name of ["left", "right", "photo", "style"]) {
      const image = find(name);
      image.src = data.pictures[pair[name]];
      if (name === "left" || name === "right") { image.width = pair.width; image.height = pair.height; }
    }
    find("vote").hidden = done;
    find("done").hidden = !done;
    find("back").disabled = at === 0;
    const given = votes[at] ? ", voted " + votes[at].choice : "";
    find("place").textContent = "Pair " + (at + 1) + " of " + data.pairs.length + given;
    find("count").textContent = Object.keys(votes).length + " of " + data.pairs.length + " votes";
    const content = {
      format: "stylerf votes", version: 1, page: data.page,
      votes: Object.keys(votes).map(Number).sort((a, b) => a - b).map(pair => ({ pair: pair, ...votes[pair] })),
    };
    const save = find("save");
    if (save.href.startsWith("blob:")) URL.revokeObjectURL(save.href);
    save.href = URL.createObjectURL(new Blob([JSON.stringify(content, null, 1)], { type: "application/json" }));
    save.download = "votes-" + data.page.slice(0, 8) + ".json";
    since = performance.now();
  }

  function vote(choice) {
    if (at >= data.pairs.length) return;
    votes[at] = { choice: choice, seconds: Math.round((performance.now() - since) / 100) / 10 };
    try { localStorage.setItem(store, JSON.stringify(votes)); } catch (error) { /* see above */ }
    at += 1;
    show();
  }

  function back() {
    at = Math.max(0, at - 1);
    show();
  }

  for (const choice of ["left", "right", "same"]) find("vote-" + choice).addEventListener("click", () => vote(choice));
  for (const side of ["left", "right"]) find(side).addEventListener("click", () => vote(side));
  find("back").addEventListener("click", back);
  document.addEventListener("keydown", event => {
    if (event.ctrlKey || event.altKey || event.metaKey || event.repeat) return;
    const act = {
      ArrowLeft: () => vote("left"), ArrowRight: () => vote("right"), ArrowDown: () => vote("same"), ArrowUp: back,
    }[event.key];
    if (act) { event.preventDefault(); act(); }
  });
  while (votes[at]) at += 1;
  show();
})();
