// A browser without a window: runs the package of clients/web against a gateway. Prints its surfaces once a second as one line
// of JSON.
//   node browser.mjs WEB URL       WEB: the folder build/web
import { resolve } from "node:path";
import { pathToFileURL } from "node:url";

const [web, url] = process.argv.slice(2);
const { digits, Live } = await import(pathToFileURL(resolve(web, "dist/index.js")));
const live = new Live(url);
setInterval(() => {
  const held = {};
  for (const [id, { surface }] of live.cars) held[id] = digits(surface.hash);
  console.log(JSON.stringify({ held, link: live.link, batches: live.received.batches }));
}, 1000);
